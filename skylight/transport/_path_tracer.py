"""A path tracer for diffuse scenes of constant albedo under distant light.

Outgoing radiance of a point x on a Lambertian surface (thesis, Eq. 3.1 and 3.15); where V = 0, the
ray meets another point y of the scene::

    L_o(x) = rho(x) / pi  int <n, w>+ (V(x, w) L_env(w) + (1 - V(x, w)) L_o(y(x, w))) dw

Directions are sampled in proportion to the cosine, so that a path's throughput is the product of
the albedos along it, the point's own included; a path that escapes in direction w contributes
L_env(w). The first directions are a Sobol sequence with a random shift for each point (Cranley and
Patterson 1976), later ones are pseudo-random. Every estimate comes with its standard error, from
independently sampled batches.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.quasirandom import SobolEngine

from skylight.errors import InputError
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import direction_from_angles, pixel_from_direction, row_edges_cos
from skylight.transport._rays import Raycaster

_RAYS = 1 << 17  # at once; their numbers stay in the processor's caches
_INWARD = 1e-4  # of the way to a triangle's centre: hits in a corner must not start beyond it


@dataclass(frozen=True, kw_only=True)
class DiffuseScene:
    """A triangle mesh of Lambertian surfaces, both sides alike; ``albedo`` for each triangle."""

    vertices: Float[Tensor, "v 3"]
    faces: Int[Tensor, "f 3"]
    albedo: Float[Tensor, " f"]

    def __post_init__(self) -> None:
        if self.albedo.shape != (len(self.faces),):
            raise InputError(
                f"one albedo for each of the {len(self.faces)} triangles, got "
                f"{tuple(self.albedo.shape)}"
            )
        _check_albedo(self.albedo)

    @staticmethod
    def uniform(
        vertices: Float[Tensor, "v 3"], faces: Int[Tensor, "f 3"], albedo: float
    ) -> "DiffuseScene":
        """One albedo everywhere."""
        return DiffuseScene(
            vertices=vertices, faces=faces, albedo=torch.full((len(faces),), albedo)
        )

    @cached_property
    def raycaster(self) -> Raycaster:
        return Raycaster(self.vertices, self.faces)

    @cached_property
    def corners(self) -> Float[Tensor, "f 3 3"]:
        return self.vertices.double()[self.faces]

    @cached_property
    def normals(self) -> Float[Tensor, "f 3"]:
        """Unit, float32, by the right hand."""
        a, b, c = self.corners.unbind(1)
        return torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=1).float()


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """How many paths for each point, in how many ``batches``, and after how many bounces to stop.

    ``bounces = 0`` is direct light alone. What is cut off is at most ``albedo^(bounces + 1)`` of
    the light, times the share of paths that have not escaped by then.
    """

    samples: int = 1024
    bounces: int = 16
    batches: int = 4

    def __post_init__(self) -> None:
        if self.batches < 2:
            raise InputError(f"a standard error needs 2 batches or more, got {self.batches}")
        if self.samples < self.batches or self.samples % self.batches:
            raise InputError(
                f"{self.samples} samples cannot be parted into {self.batches} batches: choose a "
                "multiple"
            )
        if self.bounces < 0:
            raise InputError(f"bounces must be 0 or more, got {self.bounces}")


@dataclass(frozen=True, kw_only=True)
class Traced:
    """The mean over all paths, and the standard deviation of that mean, from its batches."""

    mean: Float[Tensor, "*s"]
    standard_error: Float[Tensor, "*s"]

    @staticmethod
    def of(batches: Float[Tensor, "b *s"]) -> "Traced":
        return Traced(
            mean=batches.mean(0), standard_error=batches.std(0) / math.sqrt(batches.shape[0])
        )


def radiosity_transfer(
    positions: Float[Tensor, "m 3"],
    normals: Float[Tensor, "m 3"],
    scene: DiffuseScene,
    *,
    degree: int,
    albedo: float,
    sampling: Sampling,
    generator: torch.Generator,
) -> Traced:
    """t_i(x): outgoing radiance of points where the light is Y_i (thesis, Eq. 3.15): (m, k).

    Parameters
    ----------
    positions : on the scene's surface, or anywhere; starts are lifted along ``normals``.
    normals : unit, of the side that is looked at.
    degree : of the light's harmonics, k = (degree + 1)^2.
    albedo : of the points; the scene has its own.
    """
    _check_albedo(torch.tensor(albedo))
    if degree < 0:
        raise InputError(f"degree must be 0 or more, got {degree}")

    def escaped(directions: Tensor, cosine: Tensor) -> Tensor:
        return harmonics.evaluate(directions, degree)

    count = (degree + 1) ** 2
    means = _walk(positions, normals, scene, sampling, generator, escaped, None, channels=count)
    return Traced.of(albedo * means)


def shade(
    positions: Float[Tensor, "m 3"],
    normals: Float[Tensor, "m 3"],
    scene: DiffuseScene,
    environment: EnvironmentMap,
    *,
    albedo: float,
    sampling: Sampling,
    generator: torch.Generator,
) -> Traced:
    """Outgoing radiance (m, 3) of points under a full map, whose pixels are constant patches.

    At each end of a path one direction follows the cosine and one the map's brightness, weighed by
    the balance heuristic (Veach 1997, 9.2.2): neither small suns nor wide skies are noisy. Of a
    map with negative values, such as a cut expansion's, the magnitude is sampled.
    """
    _check_albedo(torch.tensor(albedo))
    light = _MapLight.of(environment)

    def escaped(directions: Tensor, cosine: Tensor) -> Tensor:
        radiance, density = light.seen(directions)
        by_cosine = cosine / math.pi
        return radiance * (by_cosine / (by_cosine + density).clamp(min=1e-30))[:, None]

    def lit(vertices: "_Vertices", uniform: Tensor) -> tuple[Tensor, Tensor]:
        directions, radiance, density = light.drawn(uniform)
        cosine = (directions * vertices.normals).sum(1)
        facing = torch.nonzero((cosine > 0) & (density > 0))[:, 0]
        starts, toward = vertices.starts[facing], directions[facing]
        free = facing[~scene.raycaster.occluded(starts, toward)]
        by_cosine = cosine[free] / math.pi
        return free, radiance[free] * (by_cosine / (by_cosine + density[free]))[:, None]

    means = _walk(positions, normals, scene, sampling, generator, escaped, lit, channels=3)
    return Traced.of(albedo * means)


@dataclass(frozen=True, kw_only=True)
class _Vertices:
    """Where paths stand: starts lifted off the surface, unit normals, float32."""

    starts: Float[Tensor, "r 3"]
    normals: Float[Tensor, "r 3"]

    def __getitem__(self, index: Tensor) -> "_Vertices":
        return _Vertices(starts=self.starts[index], normals=self.normals[index])


def _walk(
    positions: Tensor,
    normals: Tensor,
    scene: DiffuseScene,
    sampling: Sampling,
    generator: torch.Generator,
    escaped: Callable[[Tensor, Tensor], Tensor],
    lit: Callable[[_Vertices, Tensor], tuple[Tensor, Tensor]] | None,
    *,
    channels: int,
) -> Float[Tensor, "b m c"]:
    """Means over the paths of each batch."""
    if positions.shape != normals.shape:
        raise InputError(f"{len(positions)} positions and {len(normals)} normals do not match")
    if not len(positions):
        return torch.zeros(sampling.batches, 0, channels, dtype=torch.float64)
    count = sampling.samples // sampling.batches
    at_once = max(1, _RAYS // count)
    starts = (positions.double() + scene.raycaster.epsilon * normals.double()).float()
    points = _Vertices(starts=starts, normals=normals.float())
    result = torch.zeros(sampling.batches, len(positions), channels, dtype=torch.float64)
    for sums in result:
        seed = int(torch.randint(1 << 31, (1,), generator=generator))
        sequence = SobolEngine(4, scramble=True, seed=seed).draw(count)
        for block in torch.arange(len(positions)).split(at_once):
            shift = torch.rand(len(block), 1, 4, generator=generator)
            uniform = ((sequence + shift) % 1).reshape(-1, 4)
            owner = torch.arange(len(block)).repeat_interleave(count)
            part = torch.zeros(len(block), channels)
            _follow(
                part, points[block[owner]], owner, uniform, scene, sampling, generator, escaped, lit
            )
            sums[block] = part.double() / count
    return result


def _follow(
    sums: Float[Tensor, "m c"],
    vertices: _Vertices,
    owner: Int[Tensor, " r"],
    uniform: Float[Tensor, "r 4"],
    scene: DiffuseScene,
    sampling: Sampling,
    generator: torch.Generator,
    escaped: Callable[[Tensor, Tensor], Tensor],
    lit: Callable[[_Vertices, Tensor], tuple[Tensor, Tensor]] | None,
) -> None:
    """Add to ``sums`` what the paths from some points bring."""
    throughput = torch.ones(len(owner))
    for bounce in range(sampling.bounces + 1):
        if lit is not None:
            free, radiance = lit(vertices, uniform[:, 2:])
            sums.index_add_(0, owner[free], throughput[free, None] * radiance)
        directions, cosine = cosine_directions(vertices.normals, uniform[:, :2])
        if bounce == sampling.bounces:  # whatever is hit gives no more light
            free = ~scene.raycaster.occluded(vertices.starts, directions)
        else:
            hits = scene.raycaster.intersect(vertices.starts, directions)
            free = hits.face < 0
        radiance = escaped(directions[free], cosine[free])
        sums.index_add_(0, owner[free], throughput[free, None] * radiance)
        if bounce == sampling.bounces or bool(free.all()):
            return
        on = ~free
        face, weights = hits.face[on], hits.barycentric[on]
        weights = (1 - _INWARD) * weights + _INWARD / 3
        place = (weights[:, :, None] * scene.corners[face]).sum(1)
        normal = scene.normals[face]
        away = (normal * directions[on]).sum(1, keepdim=True) > 0
        normal = torch.where(away, -normal, normal)
        start = (place + scene.raycaster.epsilon * normal).float()
        vertices = _Vertices(starts=start, normals=normal)
        throughput = throughput[on] * scene.albedo[face].float()
        owner = owner[on]
        uniform = torch.rand(len(owner), 4, generator=generator)


def cosine_directions(
    normals: Float[Tensor, "r 3"], uniform: Float[Tensor, "r 2"]
) -> tuple[Float[Tensor, "r 3"], Float[Tensor, " r"]]:
    """(directions of density cos / pi about the normals, their cosines).

    The concentric map (Shirley and Chiu 1997) keeps what the square has well spread well spread on
    the disc; the frame about a normal is Duff et al. 2017, listing 3.
    """
    a, b = (2 * uniform - 1).unbind(1)
    wide = a.abs() > b.abs()
    radius = torch.where(wide, a, b)
    ratio = torch.where(wide, b, a) / torch.where(radius == 0, 1.0, radius) * (math.pi / 4)
    angle = torch.where(wide, ratio, math.pi / 2 - ratio)
    x, y = radius * torch.cos(angle), radius * torch.sin(angle)
    cosine = (1 - radius * radius).clamp(min=0).sqrt()
    n_x, n_y, n_z = normals.unbind(1)
    sign = torch.where(n_z < 0, -1.0, 1.0)
    p = -1 / (sign + n_z)
    q = n_x * n_y * p
    directions = torch.stack(
        [
            x * (1 + sign * n_x * n_x * p) + y * q + cosine * n_x,
            x * sign * q + y * (sign + n_y * n_y * p) + cosine * n_y,
            -x * sign * n_x - y * n_y + cosine * n_z,
        ],
        1,
    )
    return directions, cosine


@dataclass(frozen=True, kw_only=True)
class _MapLight:
    """An environment map to draw directions from, with density |R| + |G| + |B| over its sum."""

    radiance: Float[Tensor, "n 3"]
    density: Float[Tensor, " n"]  # 1/sr
    cumulative: Float[Tensor, " n"]
    layout: tuple[int, int]

    @staticmethod
    def of(environment: EnvironmentMap) -> "_MapLight":
        if environment.is_sky:
            raise InputError("a sky alone leaves the ground unknown: add one with .with_ground()")
        radiance = environment.flat.double()
        if not bool(radiance.isfinite().all()):
            raise InputError("the environment map has values that are NaN or infinite")
        size, solid = radiance.abs().sum(1), environment.grid.solid_angles
        total = (size @ solid).clamp(min=1e-300)
        return _MapLight(
            radiance=radiance.float(),
            density=(size / total).float(),
            cumulative=torch.cumsum(size * solid / total, 0),
            layout=environment.layout,
        )

    def seen(self, directions: Tensor) -> tuple[Tensor, Tensor]:
        """(radiance, density) in given directions."""
        height, width = self.layout
        row, column = pixel_from_direction(directions, height, width)
        row = row.round().long().clamp(0, height - 1)
        pixel = row * width + column.round().long() % width
        return self.radiance[pixel], self.density[pixel]

    def drawn(self, uniform: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(directions, radiance, density); uniform in solid angle inside of a pixel."""
        height, width = self.layout
        wanted, up = uniform.double().T.contiguous()
        pixel = torch.searchsorted(self.cumulative, wanted, right=True)
        pixel = pixel.clamp(max=len(self.cumulative) - 1)
        before = torch.where(pixel > 0, self.cumulative[pixel - 1], 0.0)
        share = (wanted - before) / (self.cumulative[pixel] - before).clamp(min=1e-300)
        row, column = pixel // width, pixel % width
        azimuth = ((column + share.clamp(0, 1)) / width - 0.5) * 2 * math.pi
        edges = row_edges_cos(height, width)
        zenith = torch.acos((edges[row] + up * (edges[row + 1] - edges[row])).clamp(-1, 1))
        directions = direction_from_angles(azimuth, zenith).float()
        return directions, self.radiance[pixel], self.density[pixel]


def _check_albedo(albedo: Tensor) -> None:
    if not bool(((albedo >= 0) & (albedo <= 1)).all()):
        raise InputError(
            f"an albedo lies in 0 to 1, got {float(albedo.min())} to {float(albedo.max())}"
        )
