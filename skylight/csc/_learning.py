"""Dictionaries learned from light probes.

:func:`learn_patches` takes the means of patches about bright spots, by k-means (thesis, 6.6.1.3).
:class:`CapFilterBank` is for dictionaries whose filters an optimiser moves on from there: sums of
Gaussians in a spherical cap, as blurred as patches are.

A patch is what exceeds its surroundings within a circle: luminance less its median on the
rim, clipped at 0, times a raised cosine that is 1 on the inner half of the radius and 0 on the rim.
It is rotated to the zenith and twisted so that its long axis lies along phi = 0, and its bands are
multiplied by those of the sharpest Gaussian that does not ring. So a patch is light that is nowhere
negative, blurred by a kernel that undershoots by less than 2 %; patches of real rooms undershoot by
up to 3 %.
"""

import math
from collections.abc import Iterable, Sequence

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.cluster import vq
from scipy.ndimage import map_coordinates
from scipy.optimize import nnls
from torch import Tensor, nn

from skylight._modes import full_precision, on_cpu
from skylight.csc._dictionary import (
    DEGREE,
    FilterBank,
    builtin,
    polar_longitudes,
    polar_nodes,
    project_about_pole,
    project_samples,
    sharpest_a,
    unit_rows,
)
from skylight.errors import InputError
from skylight.sphere import _harmonics as harmonics, _lobes as lobes
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import DirectionGrid, direction_from_angles, pixel_from_direction
from skylight.sphere._rotation import turn_about_pole

RADII_RAD = (math.radians(7.5), math.radians(15.0), math.radians(30.0))
# Rows of the maps that patches are cut from: pixels of 1.4 degrees, a third of what degree 40
# resolves. Finer maps are averaged down: point samples would miss what lies between them.
ROWS = 128
_NODES = 48  # from a patch's centre to its rim
# What exceeds its surroundings by less is no light but texture, or rounding on a plateau.
_LEAST_EXCESS = 1e-3
_STARTS, _ITERATIONS = 4, 50  # of k-means; the start whose patches are nearest their means counts
_VANISHED = 1e-9  # norm of a filter that the optimiser has put out


def local_maxima(brightness: Float[Tensor, "h w"], radius_rad: float) -> Float[Tensor, "n 3"]:
    """Directions, brightest first, of what is brightest within ``radius_rad`` of itself.

    Circles on the sphere, so they go round the sides and over the poles. A maximum exceeds the
    map's mean over solid angle; of equal pixels within a circle the first one counts.
    """
    height, width = brightness.shape
    grid = DirectionGrid.latlong(height, width)
    value = brightness.detach().cpu().double().flatten()
    mean = (value @ grid.solid_angles) / grid.solid_angles.sum()
    index = torch.arange(len(value))
    above = float(mean) * (1 + 1e-9)  # by more than rounding, on a constant map
    rows_each_way = math.ceil(radius_rad / math.pi * height)
    found = []
    for i in _peaks(value.reshape(height, width), above):
        first = max(i // width - rows_each_way, 0) * width
        last = min(i // width + rows_each_way + 1, height) * width
        near = grid.directions[first:last] @ grid.directions[i] >= math.cos(radius_rad)
        others = value[first:last][near]
        tie = (others == value[i]) & (index[first:last][near] < i)
        if others.max() <= value[i] and not tie.any():
            found.append(i)
    found.sort(key=lambda i: -float(value[i]))
    return grid.directions[found]


def extract_patches(
    maps: Iterable[Float[Tensor, "h w 3"]],
    degree: int = DEGREE,
    radii_rad: tuple[float, ...] = RADII_RAD,
) -> Float[Tensor, "p k"]:
    """The patches about the local maxima of full lat-long maps: coefficients of unit norm.

    For every radius, circles of that radius about the maxima over such circles. The long axis is
    that of the second moments of luminance in the tangent plane, about their mean; the third
    moment along it is positive, which decides between the two opposite twists. Nothing is mirrored.
    """
    found = [torch.zeros(0, (degree + 1) ** 2, dtype=torch.float64)]
    for radiance in maps:
        if radiance.shape[1] != 2 * radiance.shape[0]:
            raise InputError(
                f"patches are cut from full lat-long maps (width = 2 height), got "
                f"{radiance.shape[1]}x{radiance.shape[0]} (width x height)"
            )
        if radiance.shape[0] > ROWS:
            radiance = EnvironmentMap(radiance=radiance).resize(ROWS).radiance
        brightness = luminance(radiance.detach().cpu().double())
        for radius_rad in radii_rad:
            centres = local_maxima(brightness, radius_rad)
            found += [
                _patches(brightness, some, degree, radius_rad)
                for some in centres.split(64)  # bounds the memory
            ]
    return torch.cat(found)


def kmeans_filters(
    patches: Float[Tensor, "p k"], count: int = 100, *, seed: int = 0
) -> Float[Tensor, "m k"]:
    """``count`` mean patches of unit norm, that of the largest cluster first.

    Between unit vectors, Euclidean distance orders as the angle does, so ordinary k-means on them
    is the spherical one up to the norm of the means.
    """
    different = len(torch.unique(torch.round(patches * 1e6), dim=0))
    if count < 1 or different < count:
        raise InputError(
            f"{count} filters cannot be learned from {different} different patches: give more "
            "maps or ask for fewer filters"
        )
    unit = patches.double() / patches.double().norm(dim=1, keepdim=True)
    data, rng, least = unit.numpy(), np.random.default_rng(seed), math.inf
    for _ in range(_STARTS):
        centres, _ = vq.kmeans2(data, count, iter=_ITERATIONS, minit="++", rng=rng)
        nearest, distance = vq.vq(data, centres)
        if (spread := float((distance**2).sum())) < least:
            best, cluster, least = centres, nearest, spread
    sizes = np.bincount(cluster, minlength=count)
    means = torch.from_numpy(best[np.argsort(-sizes, kind="stable")])
    return means / means.norm(dim=1, keepdim=True)


def learn_patches(
    maps: Iterable[Float[Tensor, "h w 3"]],
    degree: int = DEGREE,
    count: int = 100,
    *,
    seed: int = 0,
    radii_rad: tuple[float, ...] = RADII_RAD,
) -> FilterBank:
    """The constant, ``count`` filters learned from these maps, and those of "ani": "kmeans"."""
    learned = kmeans_filters(extract_patches(maps, degree, radii_rad), count, seed=seed)
    ready = builtin("ani", degree)
    constant = FilterBank(ready.coefficients[:1], "constant")
    return FilterBank.joined("kmeans", constant, FilterBank(learned, "learned"), ready)


def _peaks(value: Float[Tensor, "h w"], above: float) -> list[int]:
    """Pixels not below their neighbours in row and column: what a maximum must be at least."""
    beyond = torch.full_like(value[:1], -math.inf)
    padded = torch.cat([beyond, value, beyond])
    neighbours = [padded[:-2], padded[2:], value.roll(1, 1), value.roll(-1, 1)]
    peak = value > above
    for neighbour in neighbours:
        peak &= value >= neighbour
    return peak.flatten().nonzero()[:, 0].tolist()


def _patches(
    brightness: Float[Tensor, "h w"], centres: Float[Tensor, "n 3"], degree: int, radius_rad: float
) -> Float[Tensor, "p k"]:
    """The patches of these centres that are not empty, windowed, of unit norm."""
    theta, weights = polar_nodes(radius_rad, _NODES)
    phi = polar_longitudes(4 * max(degree, 32))  # twice what the last band needs
    rim = _look_up(brightness, _circles(centres, torch.full_like(theta[:1], radius_rad), phi))
    level = rim.flatten(1).median(dim=1).values[:, None, None]
    values = (_look_up(brightness, _circles(centres, theta, phi)) - level).clamp(min=0)
    ramp = (2 * theta / radius_rad - 1).clamp(min=0)
    values = values * ((1 + torch.cos(math.pi * ramp)) / 2)[:, None]
    values = values[values.amax(dim=(1, 2)) > _LEAST_EXCESS * level[:, 0, 0]]
    values = values / values.amax(dim=(1, 2), keepdim=True)  # a sun's square is out of range
    rows = project_samples(values, theta, weights, degree)
    rows = turn_about_pole(rows, -_long_axis(values, theta, phi, weights))
    l = torch.arange(degree + 1, dtype=torch.float64)  # noqa: E741
    window = torch.exp(-l * (l + 1) / (4 * sharpest_a(degree) ** 2))
    rows = rows * window[harmonics.bands(degree)]
    return rows / rows.norm(dim=1, keepdim=True)


def _circles(
    centres: Float[Tensor, "n 3"], theta: Float[Tensor, " t"], phi: Float[Tensor, " p"]
) -> Float[Tensor, "n t p 3"]:
    """Directions at (theta, phi) about each centre, with some direction for phi = 0."""
    # the axis along which the centre is shortest is never parallel to it
    helper = torch.eye(3, dtype=centres.dtype)[centres.abs().argmin(dim=1)]
    ahead = torch.linalg.cross(centres, helper)
    ahead = ahead / ahead.norm(dim=1, keepdim=True)
    aside = torch.linalg.cross(centres, ahead)  # +Y x +Z = +X: phi goes from ahead to aside
    sine = torch.sin(theta)[:, None]
    local = torch.stack(
        [
            sine * torch.cos(phi),
            sine * torch.sin(phi),
            torch.cos(theta)[:, None].expand(-1, len(phi)),
        ],
        dim=-1,
    )
    return torch.einsum("tpi,nij->ntpj", local, torch.stack([ahead, aside, centres], dim=1))


def _look_up(
    brightness: Float[Tensor, "h w"], directions: Float[Tensor, "*s 3"]
) -> Float[Tensor, "*s"]:
    """Bilinear, continued across sides and poles."""
    height, width = brightness.shape
    row, column = pixel_from_direction(directions, height, width)
    # one row beyond each pole is that pole's own row, half a turn away
    over = brightness.roll(width // 2, 1)
    padded = torch.cat([over[:1], brightness, over[-1:]])
    padded = torch.cat([padded[:, -1:], padded, padded[:, :1]], dim=1)
    place = np.stack([row.numpy() + 1, column.numpy() % width + 1])
    return torch.from_numpy(map_coordinates(padded.numpy(), place, order=1, mode="nearest"))


def _long_axis(
    values: Float[Tensor, "n t p"],
    theta: Float[Tensor, " t"],
    phi: Float[Tensor, " p"],
    weights: Float[Tensor, " t"],
) -> Float[Tensor, " n"]:
    """The phi along which the light is spread most, and to which side its longer tail goes."""
    share = values * weights[:, None]
    share = share / share.sum(dim=(1, 2), keepdim=True)
    u, v = theta[:, None] * torch.cos(phi), theta[:, None] * torch.sin(phi)
    u = u - (share * u).sum(dim=(1, 2))[:, None, None]
    v = v - (share * v).sum(dim=(1, 2))[:, None, None]
    uu, uv, vv = ((share * product).sum(dim=(1, 2)) for product in (u * u, u * v, v * v))
    angle = torch.atan2(2 * uv, uu - vv) / 2
    along = torch.cos(angle)[:, None, None] * u + torch.sin(angle)[:, None, None] * v
    skew = (share * along**3).sum(dim=(1, 2))
    return torch.where(skew < 0, angle + math.pi, angle)


class CapFilterBank(FilterBank):
    """The filters ``learned`` of a dictionary as ``amounts @ lobes``; the others are constants.

    ``lobes`` are Gaussians about the nodes of a cap round the zenith, as sharp as the degree holds
    without ringing. ``amounts`` (m, n), the one parameter, starts at the non-negative least squares
    of the given filters. Non-negative amounts make filters that are light of some shape, blurred,
    which undershoot about as little as Gaussians do; after a step of an optimiser
    :meth:`project_` brings them back to that set.

    Parameters
    ----------
    bank : the dictionary to start from.
    learned : numbers of its filters.
    radius_rad : of the cap.
    signed : lets filters be negative.

    Raises
    ------
    InputError
        A learned filter that is none of the bank's, or the constant; a cap without room.
    """

    learned: Int[Tensor, " m"]
    lobes: Float[Tensor, "n k"]

    @on_cpu
    def __init__(
        self,
        bank: FilterBank,
        learned: Sequence[int],
        *,
        radius_rad: float = math.radians(30.0),
        signed: bool = False,
    ) -> None:
        super().__init__(bank.coefficients, bank.name, learnable=False)
        wrong = [i for i in learned if not 0 <= i < len(bank)]
        if wrong or not learned or len(set(learned)) != len(learned):
            raise InputError(
                f"learned filters are different ones of 0 to {len(bank) - 1}, got {list(learned)}"
            )
        if any(bank.constant[list(learned)]):
            raise InputError("the constant filter cannot be learned: leave it out of `learned`")
        if not 0 < radius_rad <= math.pi / 2:
            raise InputError(
                "the radius of learned filters is above 0 and at most 90 degrees, got "
                f"{math.degrees(radius_rad):g}"
            )
        self.signed = signed
        self.register_buffer("learned", torch.tensor(list(learned)), persistent=False)
        self.register_buffer("lobes", cap_lobes(radius_rad, bank.degree), persistent=False)
        self.amounts = nn.Parameter(_amounts(self.unnormalised[self.learned], self.lobes))
        self.project_()

    @property
    def coefficients(self) -> Float[Tensor, "m k"]:
        """Real SH coefficients of all filters, of unit norm."""
        with full_precision(self.amounts):
            learned = self.amounts @ self.lobes
            return unit_rows(self.unnormalised.index_copy(0, self.learned, learned))

    @torch.no_grad()
    def project_(self) -> None:
        """Amounts of 0 or more (unless signed), and filters of unit norm, in place."""
        if not self.signed:
            self.amounts.clamp_(min=0)
        norms = (self.amounts @ self.lobes).norm(dim=1)
        for gone in torch.nonzero(norms < _VANISHED)[:, 0].tolist():
            self.amounts[gone] = 0
            self.amounts[gone, 0] = norms[gone] = 1.0
        self.amounts /= norms[:, None]


def cap_nodes(radius_rad: float, degree: int) -> Float[Tensor, "n 3"]:
    """Directions on a Fibonacci spiral that begins at the zenith.

    They are a standard deviation of that degree's sharpest Gaussian from each other, so that sums
    of Gaussians about them hold no gaps.
    """
    a = sharpest_a(degree)
    # exp(-a^2 theta^2): a variance of 1 / (2 a^2)
    count = max(1, round(4 * math.pi * math.sin(radius_rad / 2) ** 2 * 2 * a**2))
    i = torch.arange(count, dtype=torch.float64)
    theta = 2 * torch.asin(math.sin(radius_rad / 2) * torch.sqrt(i / count))
    golden = math.pi * (3 - math.sqrt(5))
    return direction_from_angles(math.pi - golden * i, theta)


def cap_lobes(radius_rad: float, degree: int) -> Float[Tensor, "n k"]:
    """Gaussians of unit norm about :func:`cap_nodes`, as sharp as the degree holds."""
    a = torch.tensor([[[sharpest_a(degree)]]], dtype=torch.float64)
    gaussian = project_about_pole(lambda theta, phi: lobes.gaussian(theta, a), degree, columns=1)[0]
    # one column of phi says nothing about the orders that are left out
    bands = harmonics.zonal_factors(gaussian) / gaussian[harmonics.orders(degree) == 0].norm()
    basis = harmonics.evaluate_about_zenith(cap_nodes(radius_rad, degree), degree)
    return basis * bands[harmonics.bands(degree)]


def _amounts(
    filters: Float[Tensor, "m k"], gaussians: Float[Tensor, "n k"]
) -> Float[Tensor, "m n"]:
    """The amounts >= 0 whose sums are nearest to these filters."""
    q, r = np.linalg.qr(gaussians.T.numpy())
    right = filters.double().numpy() @ q
    rows = [nnls(r, row, maxiter=30 * len(gaussians))[0] for row in right]
    return torch.from_numpy(np.stack(rows))
