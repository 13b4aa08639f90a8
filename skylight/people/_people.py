"""Random people: shape, pose, skin, a cap of hair."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from scipy.spatial.transform import Rotation

from skylight.faces._fit import FaceFit
from skylight.faces._model import HeadModel, Region
from skylight.faces._synthetic import field
from skylight.people._light import RenderOptions
from skylight.people._skin import CLUSTERS, Paint, SmoothHead, normals_of, paint
from skylight.transport._cameras import Camera
from skylight.transport._rays import Raycaster
from skylight.transport._render import rasterize

_FACE_M = 0.21  # chin to crown of the mean head's face, as render_face has it


@dataclass(frozen=True, kw_only=True)
class Cap:
    """Hair as a shell over the scalp."""

    points: Float[ndarray, "c 3"]
    faces: Int[ndarray, "k 3"]


@dataclass(frozen=True, kw_only=True)
class Person:
    """``points`` is the smooth head in the camera's frame, ``cap`` (or None) its hair."""

    cluster: int
    truth: FaceFit
    points: Float[ndarray, "m 3"]
    paint: Paint
    cap: Cap | None


@lru_cache(maxsize=8)  # faces of one scene ask for each other
def person(number: int, focal: float, options: RenderOptions) -> Person:
    """Face ``number``'s person: tone cluster ``number`` mod 6, the rest drawn at random.

    Yaw 15, pitch 8, roll 5 degrees (standard deviations); the face fills 55 to 70 % of the
    picture, whose focal length is ``focal`` times its side.
    """
    rng = np.random.default_rng((options.seed, number, 1))
    model, head = HeadModel.load(), SmoothHead.load()
    identity, expression = model.sample(rng)
    yaw, pitch, roll = np.radians(rng.normal(size=3) * [15, 8, 5])
    rotation = Rotation.from_euler("yxz", [yaw, pitch, roll]).as_matrix()
    distance = focal * _FACE_M / rng.uniform(0.55, 0.7)
    translation = np.array([rng.normal(0, 0.006), rng.normal(-0.015, 0.006), -distance])
    shape = model.vertices(identity, expression)
    size = options.size
    cluster = number % CLUSTERS
    own = head.points(shape)
    colours = paint(cluster, rng)
    cap = hair_cap(own, rng) if options.hair else None
    if cap is not None:
        cap = Cap(points=cap.points @ rotation.T + translation, faces=cap.faces)
    return Person(
        cluster=cluster,
        truth=FaceFit(
            camera=Camera(
                focal_px=focal * size, width=size, height=size, center_px=(size / 2, size / 2)
            ),
            rotation=rotation,
            translation=translation,
            identity=identity,
            expression=expression,
            vertices=shape @ rotation.T + translation,
            landmark_error=0.0,
            converged=True,
        ),
        points=own @ rotation.T + translation,
        paint=colours,
        cap=cap,
    )


def hair_cap(points: Float[ndarray, "m 3"], rng: np.random.Generator) -> Cap:
    """A shell 6 to 16 mm over the scalp whose fringe ends 1 to 4 cm over the brows."""
    head, model = SmoothHead.load(), HeadModel.load()
    brows = model.landmarks(model.mean)[17:27, 1].max()
    length = rng.uniform(0.0, 0.03) + 0.004 * field(head.neutral, 0.02, rng)
    lowest = brows + 0.008 + (0.03 - length).clip(0)
    fringe = (head.belongs[Region.FACE] > 0.5) & (head.neutral[:, 1] > lowest)
    covered = (head.belongs[Region.SCALP] > 0.4) | fringe
    chosen = head.faces[covered[head.faces].all(1)]
    kept, faces = np.unique(chosen, return_inverse=True)
    thick = rng.uniform(0.006, 0.016) * (1 + 0.25 * field(head.neutral, 0.012, rng)[kept])
    upright = normals_of(points, head.faces)[kept]
    return Cap(points=points[kept] + thick[:, None] * upright, faces=faces.reshape(-1, 3))


def bare_skin() -> Bool[ndarray, " m"]:
    """The smooth head's vertices that are wholly :attr:`Region.FACE`."""
    return SmoothHead.load().belongs[Region.FACE] > 0.99


def outer_skin() -> Bool[ndarray, " m"]:
    """The smooth head's vertices of skin that is not in a hole: nostril, mouth or eye socket.

    The holes' walls in the head model are no anatomy: some lie a millimetre behind the face.
    """
    holes = [Region.EYEBALL, Region.MOUTH, Region.HIDDEN]
    return SmoothHead.load().belongs[holes].sum(0) <= 0.5


@dataclass(frozen=True, kw_only=True)
class Seen:
    """What the centre of each pixel shows: outer ``skin``, ``bare`` skin of the face, hair.

    ``positions`` are the surface's, in metres and the camera's frame, 0 where nobody is.
    """

    positions: Float[ndarray, "h w 3"]
    skin: Bool[ndarray, "h w"]
    bare: Bool[ndarray, "h w"]
    hair: Bool[ndarray, "h w"]

    def pixel_m(self, camera: Camera) -> float:
        """A pixel's side at the median depth of the skin, metres."""
        return float(np.median(-self.positions[self.skin][:, 2])) / camera.focal_px


def seen_parts(person: Person) -> Seen:
    """By casting one ray a pixel at head and cap."""
    head = SmoothHead.load()
    points, faces = person.points, head.faces
    if person.cap is not None:
        faces = np.concatenate([faces, person.cap.faces + len(points)])
        points = np.concatenate([points, person.cap.points])
    mesh, triangles = torch.from_numpy(points), torch.from_numpy(faces.copy())
    surface = rasterize(person.truth.camera, mesh, triangles, Raycaster(mesh, triangles))
    of_head = len(head.faces)
    kinds = np.zeros((len(faces), 3))
    kinds[:of_head, 0] = outer_skin()[head.faces].all(1)
    kinds[:of_head, 1] = bare_skin()[head.faces].all(1)
    kinds[of_head:, 2] = 1
    shown = torch.from_numpy(kinds)[surface.faces]
    picture = surface.image(torch.cat([surface.positions, shown], 1)).numpy()
    return Seen(
        positions=picture[..., :3],
        skin=picture[..., 3] > 0,
        bare=picture[..., 4] > 0,
        hair=picture[..., 5] > 0,
    )
