"""The rows of the surface along which the jaw's landmarks slide when the head turns."""

import igl
import numpy as np

from tools.head.shape import Shape


def contour_rows(
    shape: Shape, landmark: np.ndarray, region: np.ndarray, count: int = 16
) -> tuple[np.ndarray, np.ndarray]:
    """Where the jaw landmarks 0..16 may slide: triangles (17, count), barycentrics (17, count, 3).

    Ordered from the face to the back.

    Row i walks over the outer skin through landmark i, in the plane perpendicular to the jaw line
    there: 40 mm towards the cheek at the ear, 14 mm towards the lips at the chin, and 18 mm back or
    under. Away from the chin a turned head shows its outline far in front of the frontal one.
    """
    outer = np.isin(region, (0, 4, 6, 7)) & (shape.part == 0)
    chosen = np.flatnonzero(outer[shape.faces].all(axis=1))
    faces = shape.faces[chosen]
    mean = shape.mean
    mark = mean[landmark[:17]]
    rows = np.empty((17, count), dtype=np.int64)
    bary = np.empty((17, count, 3))
    step = 0.002
    for i in range(17):
        along = mark[min(i + 1, 16)] - mark[max(i - 1, 0)]
        along /= np.linalg.norm(along)
        reach = {1.0: np.interp(abs(i - 8), [0, 5, 8], [0.014, 0.036, 0.040]), -1.0: 0.018}
        path = {0.0: mark[i]}
        for sign, length in reach.items():
            point, heading = mark[i], np.array([0.0, 0.0, sign])
            for k in range(1, int(np.ceil(length / step)) + 1):
                _, face, _ = igl.point_mesh_squared_distance(point[None], mean, faces)
                a, b, c = mean[faces[int(np.ravel(face)[0])]]
                normal = np.cross(b - a, c - a)
                normal /= np.linalg.norm(normal)
                heading = heading - along * (heading @ along)
                heading = heading - normal * (heading @ normal)
                heading /= np.linalg.norm(heading)
                _, _, near = igl.point_mesh_squared_distance(
                    (point + step * heading)[None], mean, faces
                )
                point = np.reshape(near, 3)
                path[sign * k * step] = point
        at = np.array(sorted(path, reverse=True))
        track = np.stack([path[t] for t in at])
        want = np.linspace(at[0], at[-1], count)
        points = np.stack([np.interp(-want, -at, track[:, d]) for d in range(3)], axis=1)
        points[np.abs(want).argmin()] = mark[i]
        _, hit, point = igl.point_mesh_squared_distance(points, mean, faces)
        rows[i] = chosen[hit]
        corners = [np.ascontiguousarray(mean[faces[hit][:, j]]) for j in range(3)]
        mix = igl.barycentric_coordinates(np.ascontiguousarray(point), *corners).clip(0, 1)
        bary[i] = mix / mix.sum(axis=1, keepdims=True)
    return rows, bary
