"""Where the points of MediaPipe's face mesh lie on the head model, and the average face.

    python tools/register_face_mesh.py --canonical canonical_face_model.obj

adds ``average``, ``mesh_points``, ``mesh_faces`` and ``mesh_bary`` to ``head.npz``, which
``tools/build_head.py`` made. MediaPipe's canonical face (Apache-2.0, ``canonical_face_model.obj``
of its repository; centimetres, the face along +Z) is what its network's people are like, and in
its frame a frontal face has no pitch; the middle of MakeHuman's parameters is an artist's. The
identity ``a``, a scale s and a shift t minimise ::

    sum_i (<n_i, s v_i + t - X_i(a)> / 1.5 mm)^2 + sum_l |s v_l + t - X_l(a)|^2 / (4 mm)^2 + |a|^2

over all 468 points v_i, whose nearest points X_i on the head have normals n_i, and the 51 inner
landmarks l. No rotation: it would pass for shape. The average face is that a; people are taken to
vary about it as MakeHuman's do about its own. Every second point is kept for fits (and the eyes'
outer corners): neighbours err together.
"""

import argparse
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.spatial import KDTree

from skylight.faces._landmarks import MESH_EYES
from skylight.faces._mediapipe import IBUG
from skylight.io._atomic import atomic_path

HEAD = Path(__file__).resolve().parents[1] / "skylight/faces/data/head.npz"
PLANE_M, LANDMARK_M = 0.0015, 0.004
ROUNDS, STEP = 40, 0.5
INNER = np.arange(17, 68)
KEPT = np.union1d(np.arange(0, 468, 2), MESH_EYES)
SURFACE = (0, 1, 3, 4, 5, 6, 7, 8)  # values of Region: all but the inside of the mouth
_LATTICE = np.array([(i, j, 8 - i - j) for i in range(9) for j in range(9 - i)]) / 8


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--canonical", type=Path, required=True)
    parser.add_argument("--head", type=Path, default=HEAD)
    arguments = parser.parse_args()
    with np.load(arguments.head) as stored:
        head = dict(stored)
    canonical = read_points(arguments.canonical) / 100
    average, faces, bary, gap = register(head, canonical)
    print(f"median distance {1e3 * np.median(gap):.2f} mm, 90 % {1e3 * np.quantile(gap, 0.9):.2f}")
    print(f"|a| = {np.linalg.norm(average):.1f} of {len(average)} coefficients")
    head |= {
        "average": average.astype(np.float32),
        "mesh_points": KEPT.astype(np.uint16),
        "mesh_faces": faces[KEPT].astype(np.uint16),
        "mesh_bary": bary[KEPT].astype(np.float32),
    }
    with atomic_path(arguments.head) as path, path.open("wb") as stream:
        np.savez_compressed(stream, **head)


def read_points(path: Path) -> Float[ndarray, "468 3"]:
    """The vertices of a Wavefront file."""
    lines = [line.split() for line in path.read_text().splitlines()]
    return np.array([line[1:4] for line in lines if line and line[0] == "v"], dtype=np.float64)


def register(
    head: dict[str, ndarray], canonical: Float[ndarray, "468 3"]
) -> tuple[
    Float[ndarray, " k"], Int[ndarray, "468"], Float[ndarray, "468 3"], Float[ndarray, "468"]
]:
    """(identity, triangle and barycentric coordinates of every point, distances in metres)."""
    mean, identity = head["mean"].astype(np.float64), head["identity"] * float(head["step"])
    kept = np.flatnonzero(np.isin(head["regions"], SURFACE)[head["faces"]].all(1))
    faces = head["faces"][kept].astype(np.int64)
    mark_corners = head["faces"][head["landmark_faces"]][INNER].astype(np.int64)
    mark_bary = head["landmark_bary"][INNER].astype(np.float64)
    marks = np.einsum("lc,lcd->ld", mark_bary, mean[mark_corners])
    mark_basis = np.einsum("lc,lcdk->ldk", mark_bary, identity[mark_corners])
    ibug = np.array(IBUG)[INNER]
    points = canonical - canonical[ibug].mean(0) + marks.mean(0)
    average = np.zeros(identity.shape[2])
    for _ in range(ROUNDS):
        vertices = mean + identity @ average
        face, bary, nearest = nearest_on(vertices, faces, points)
        normals = np.cross(*np.diff(vertices[faces[face]], axis=1).transpose(1, 0, 2))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        basis = np.einsum("pc,pcdk->pdk", bary, identity[faces[face]])
        rows = [
            np.einsum("pd,pdk->pk", normals, basis) / PLANE_M,
            mark_basis.reshape(-1, len(average)) / LANDMARK_M,
            np.eye(len(average)),
        ]
        gap = (points[ibug] - marks - mark_basis @ average).ravel()
        values = [
            ((points - nearest) * normals).sum(1) / PLANE_M,
            gap / LANDMARK_M,
            -average,
        ]
        step = np.linalg.lstsq(np.concatenate(rows), np.concatenate(values), rcond=None)[0]
        average = average + STEP * step
        nearest = nearest + STEP * basis @ step
        middle = points.mean(0)
        scale = ((points - middle) * (nearest - nearest.mean(0))).sum()
        scale /= ((points - middle) ** 2).sum()
        points = scale * (points - middle) + nearest.mean(0)
    face, bary, nearest = nearest_on(mean + identity @ average, faces, points)
    return average, kept[face], bary, np.linalg.norm(points - nearest, axis=1)


def nearest_on(
    vertices: Float[ndarray, "n 3"], faces: Int[ndarray, "f 3"], points: Float[ndarray, "p 3"]
) -> tuple[Int[ndarray, " p"], Float[ndarray, "p 3"], Float[ndarray, "p 3"]]:
    """(triangle, barycentric coordinates, position) nearest each point, to an eighth of an edge."""
    lattice = np.einsum("lc,fcd->fld", _LATTICE, vertices[faces]).reshape(-1, 3)
    _, number = KDTree(lattice).query(points)
    face, place = np.divmod(number, len(_LATTICE))
    return face, _LATTICE[place], lattice[number]


if __name__ == "__main__":
    main()
