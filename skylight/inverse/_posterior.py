"""How sure is the light? A density over the sun's direction, and intervals.

**Sun.** The linear scan finds the best explanation of a face with the sun at d. The weights are
divided, for all d alike, by the deviations (to a floor) that the best d leaves, twice, so that
outliers (brows, beards, highlights) count for little; the residual is then about the mean absolute
deviation m(d) over the face's mean.
As in the objective, an explanation is unlikely by its deviation, in units of a temperature::

    L(d) ~ exp(-m(d) / t),

for several faces under one light with the sum of their m(d). No direction of the upper hemisphere
is preferred beforehand. What heads are wrong by beyond the errors that the scan knows turns their
light too, so L is spread by a von Mises-Fisher kernel V. The optimisation knows more than the scan,
namely which skies there are; its sun s enters as a lobe about it plus a constant, since some
estimates are outliers. As a density over the hemisphere, ::

    p(d) ~ (V * L)(d) (1 + h V_s(d) / V_s(s))^k.

Where clock and place tell of the sun (:mod:`skylight.inverse._sun_prior`), p is multiplied by their
density q. Whether they can be right is asked of the faces alone, without the optimised sun, which
q has drawn: a share f of q is uniform, for clocks and compasses that are wrong, and they are wrong
with a probability of ``f / 2 pi`` over ``int (V * L) q``. Light of the whole sphere has ``4 pi``
there, and in f what main lights are not the sun: a lamp elsewhere says nothing of the clock.

**No sun.** Where the best sun lowers m by little against ambient light alone, no sun is seen;
lamps are where the light found has some, since their number is chosen by its evidence.
Where a lamp at the camera lowers it by as much as the best sun, it may have been a flash.

**Exposure and albedo.** A picture fixes their product, and the prior over skin, its hue as
uncertain as the light's, says how it may be split: see :func:`split_density`.

Of :class:`PosteriorConstants`, ``temperature``, ``kernel_rad``, ``estimate_rad``,
``estimate_height`` and ``estimate_weight`` are near the likeliest of 45 rendered faces, by
``tools/calibrate_posterior.py``: 0.03 nats a face below the best of those tried. The others were
tuned by hand on development faces: ``sun_gain`` and the ``..._spread``.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from torch import Tensor

from skylight._modes import constant
from skylight.inverse._scale import SPECULAR_SPREAD
from skylight.inverse._scan import FaceScan, scan_faces
from skylight.inverse._sun_prior import FLOOR, SunPrior
from skylight.models._base import Prior
from skylight.sphere._envmap import luminance
from skylight.sphere._frame import DirectionGrid, squared_chords
from skylight.sphere._row_kernels import RowKernels
from skylight.transport._observation import Observation

SHARE = 0.9
DOUBT = 0.5  # clocks that are more likely wrong than right
# of the upper hemisphere: 2.8 degrees, half the scan's cells; of the sphere: 5.6, the scan's own
ROWS = 32
REWEIGHTINGS = 2
LIKELIEST = 256  # directions, among which the best one is after another reweighting
LEAST_DEVIATION = 0.05  # of the face's mean: smaller ones do not count more
CAMERA_SHARE = 0.97  # of the best sun's gain: one at the horizon ahead looks like a flash
_NEIGHBOURS = 1.6  # cells, whose diagonal is 1.4 of their height


@dataclass(frozen=True, kw_only=True)
class PosteriorConstants:
    """Constants of the posterior; ``_rad`` are spreads per axis.

    ``temperature`` t, ``kernel_rad`` of V, and ``estimate_rad``, ``estimate_height`` h and
    ``estimate_weight`` k of the estimate's lobe. A sun that lowers the deviation by less than
    ``sun_gain`` is none. ``..._spread`` are of log exposure and log albedo beyond what the skin
    prior tells; exposure adds ``unseen_spread`` times the share of the hemisphere in the region,
    since a sun that the face hardly sees may be of any strength.
    """

    temperature: float = 0.027
    kernel_rad: float = math.radians(6.0)
    estimate_rad: float = math.radians(8.0)
    estimate_height: float = 30.0
    estimate_weight: float = 1.25
    sun_gain: float = 0.085
    exposure_spread: float = 0.25
    unseen_spread: float = 1.0
    albedo_spread: float = 0.3


FITTED = PosteriorConstants()


@dataclass(frozen=True, kw_only=True)
class SunEvidence:
    """Evidence of the faces for the sun: m(d) of the module's text (n,), summed over the faces.

    ``gain``: by how much the best sun lowers the deviation of a face, against no sun at all;
    ``camera_gain``: by how much a lamp at the camera does.
    """

    deviations: Float[Tensor, " n"]
    gain: float
    camera_gain: float = 0.0


@dataclass(frozen=True, kw_only=True)
class RegionPart:
    """A connected part of a region: its share of all probability and its densest direction."""

    share: float
    peak: Float[Tensor, "3"]


@dataclass(frozen=True, kw_only=True)
class SunPosterior:
    """Where the sun may be, and how well exposure and albedo are known.

    ``density`` (n,) per sr over the directions of ``grid``, the upper hemisphere (of lamps the
    sphere), integrates to 1; it supposes that there is a sun. ``region`` is the smallest set of
    directions with 90 % of it, ``parts`` its connected parts, likeliest first. ``sun_gain`` is by
    how much of the face's mean the best sun lowers the deviation. The intervals (90 %) are those of
    :attr:`Estimate.exposure` and of a common factor on :attr:`Estimate.albedo`. ``clock_wrong`` is
    how likely the picture's time, place or heading are wrong, None where they told nothing.
    ``is_seen``: a sun, or a lamp, is seen at all.
    """

    grid: DirectionGrid
    density: Float[Tensor, " n"]
    region: Bool[Tensor, " n"]
    parts: tuple[RegionPart, ...]
    sun_gain: float
    exposure_interval: tuple[float, float]
    albedo_scale_interval: tuple[float, float]
    clock_wrong: float | None = None
    is_seen: bool = True
    by_camera: bool = False

    @property
    def region_sr(self) -> float:
        """Solid angle of the region."""
        return float(self.grid.solid_angles[self.region].sum())

    @property
    def region_radius_rad(self) -> float:
        """Radius r of the cap as large as the region: 2 pi (1 - cos r)."""
        return math.acos(1 - min(self.region_sr / (2 * math.pi), 2.0))


@dataclass(frozen=True, kw_only=True)
class FaceEvidence:
    """Evidence of one face: its share of m(d).

    ``without_sun`` are its deviations without any sun, ``camera_lit`` with the camera's lamp.
    """

    deviations: Float[Tensor, " n"]
    without_sun: float
    camera_lit: float


def sun_evidence(faces: Sequence[FaceEvidence]) -> SunEvidence:
    """That of all faces under one light."""
    total = torch.stack([face.deviations for face in faces]).sum(0).cpu()
    without_sun = math.fsum(face.without_sun for face in faces)
    return SunEvidence(
        deviations=total,
        gain=(without_sun - float(total.min())) / len(faces),
        camera_gain=(without_sun - math.fsum(face.camera_lit for face in faces)) / len(faces),
    )


def face_evidence(
    observations: Sequence[Observation], scans: Sequence[FaceScan], *, sphere: bool = False
) -> list[FaceEvidence]:
    """Robust scans of faces, under one light or several, from their ordinary scans.

    Over the directions that these have: the upper hemisphere's or the whole ``sphere``'s.
    """
    weights = [one.weights.double() / one.weights.double().sum() for one in observations]
    seen = [luminance(one.pixels).double() for one in observations]
    means = [weight @ level for weight, level in zip(weights, seen, strict=True)]
    robust = weights
    for left in reversed(range(REWEIGHTINGS)):
        robust = [
            weight / ((scan.deviations / mean).square() + LEAST_DEVIATION**2).sqrt()
            for weight, scan, mean in zip(weights, scans, means, strict=True)
        ]
        scans = scan_faces(
            [
                replace(one, weights=weight.float())
                for one, weight in zip(observations, robust, strict=True)
            ],
            sphere=sphere,
            before=scans,
            likeliest=LIKELIEST if left else None,  # the best is what weights are told by
        )
    energies = [
        weight @ (level / mean).square()
        for weight, level, mean in zip(robust, seen, means, strict=True)
    ]
    return [
        FaceEvidence(
            deviations=scan.unexplained * energy,
            without_sun=scan.without_sun * float(energy),
            camera_lit=scan.camera_lit * float(energy),
        )
        for scan, energy in zip(scans, energies, strict=True)
    ]


def sun_density(
    evidence: SunEvidence,
    estimate: Float[Tensor, "3"] | None,
    model: PosteriorConstants = FITTED,
    sun_prior: SunPrior | None = None,
) -> Float[Tensor, " n"]:
    """p of the module's text at the directions of the :func:`density_grid`, per sr.

    ``evidence`` is about the scan's directions; ``estimate`` is the optimised sun, and
    ``sun_prior`` what clock and place tell; None where there is none.
    """
    cells, fine = _scan_grid(evidence), density_grid(evidence)
    nats = (evidence.deviations - evidence.deviations.min()) / model.temperature
    kernel = _kernel(model.kernel_rad, fine.is_sphere)
    # no lobe is negative, but what Fourier transforms round may be
    density = kernel.spread(torch.exp(-nats) * cells.solid_angles).clamp(min=0)
    if estimate is not None:
        lobe = _lobes(fine, estimate[None], model.estimate_rad)[:, 0]
        density = density * (1 + model.estimate_height * lobe) ** model.estimate_weight
    if sun_prior is not None:
        density = density * sun_prior.log_density(fine.directions).exp()
    return density / (density @ fine.solid_angles)


def _scan_grid(evidence: SunEvidence) -> DirectionGrid:
    """Its directions: 32 rows of the sphere, or the upper half of them."""
    sky = DirectionGrid.sky(ROWS // 2)
    return sky if len(evidence.deviations) == len(sky) else DirectionGrid.latlong(ROWS)


def density_grid(evidence: SunEvidence) -> DirectionGrid:
    """Where the density is told: on 32 rows of what the scan covered."""
    return (
        DirectionGrid.latlong(ROWS) if _scan_grid(evidence).is_sphere else DirectionGrid.sky(ROWS)
    )


def clock_wrong(
    evidence: SunEvidence, sun_prior: SunPrior, model: PosteriorConstants = FITTED
) -> float:
    """How likely clock, place or compass are wrong, by the module's text."""
    wrong = FLOOR * sun_prior.open_sky / sun_prior.floor  # of what is not where they say
    return wrong * _elsewhere(evidence, sun_prior, model)


def _elsewhere(
    evidence: SunEvidence, sun_prior: SunPrior, model: PosteriorConstants = FITTED
) -> float:
    """How likely the main light is not where clock, place and compass say."""
    fine = density_grid(evidence)
    mass = sun_density(evidence, None, model) * fine.solid_angles
    told = sun_prior.clock_log_density(fine.directions).exp()
    right = (1 - sun_prior.floor) * float(mass @ told)
    return sun_prior.elsewhere / (sun_prior.elsewhere + right)


def credible(evidence: SunEvidence, sun_prior: SunPrior | None) -> SunPrior | None:
    """``sun_prior`` unless the faces contradict it."""
    if sun_prior is None or _elsewhere(evidence, sun_prior) > DOUBT:
        return None
    return sun_prior


@constant(2)
def _kernel(spread_rad: float, sphere: bool) -> RowKernels:
    """Lobes about the scan's cells at the density's directions."""
    if sphere:
        fine = cells = DirectionGrid.latlong(ROWS)
    else:
        fine, cells = DirectionGrid.sky(ROWS), DirectionGrid.sky(ROWS // 2)
    return RowKernels.of(partial(_lobes, spread_rad=spread_rad), fine, cells)


def _lobes(
    grid: DirectionGrid, centres: Float[Tensor, "k 3"], spread_rad: float
) -> Float[Tensor, "n k"]:
    """Von Mises-Fisher lobes of height 1, of a spread per axis that is small."""
    return torch.exp(-0.5 * squared_chords(grid.directions, centres.double()) / spread_rad**2)


def smallest_region(
    density: Float[Tensor, " n"], solid_angles: Float[Tensor, " n"], share: float = SHARE
) -> Bool[Tensor, " n"]:
    """The densest directions, as few as hold ``share`` of the whole."""
    order = density.argsort(descending=True, stable=True)
    mass = (density * solid_angles)[order]
    before = mass.cumsum(0) - mass
    region = torch.zeros(len(density), dtype=torch.bool)
    region[order[before < share * mass.sum()]] = True
    return region


def region_parts(
    grid: DirectionGrid, density: Float[Tensor, " n"], region: Bool[Tensor, " n"]
) -> tuple[RegionPart, ...]:
    """The connected parts of a region of a lat-long grid, likeliest first."""
    assert grid.layout is not None
    height = 2 * math.pi / grid.layout[1]  # of a row, as of a column at the horizon
    directions = grid.directions[region]
    mass = (density * grid.solid_angles)[region]
    chord = 2 * math.sin(_NEIGHBOURS * height / 2)
    near = KDTree(directions.numpy()).query_pairs(chord, output_type="ndarray")
    graph = coo_array((np.ones(len(near)), tuple(near.T)), shape=(len(mass), len(mass)))
    count, labels = connected_components(graph, directed=False)
    parts = []
    for label in range(count):
        inside = torch.from_numpy(labels == label)
        peak = directions[inside][density[region][inside].argmax()]
        parts.append(RegionPart(share=float(mass[inside].sum()), peak=peak))
    return tuple(sorted(parts, key=lambda part: -part.share))


def sun_posterior(
    evidence: SunEvidence,
    estimate: Float[Tensor, "3"] | None,
    *,
    exposure: float,
    albedo: Float[Tensor, "3"],
    specular_scale: float | None,
    albedo_prior: Prior,
    model: PosteriorConstants = FITTED,
    sun_prior: SunPrior | None = None,
    seen: bool | None = None,
) -> SunPosterior:
    """The posterior of the light found.

    ``seen``: the light found has a lamp. By default a sun is seen where it lowers the deviation by
    ``sun_gain`` of the constants.
    ``exposure``, ``albedo`` and ``specular_scale`` (None where the model has none) are the face's.
    """
    grid = density_grid(evidence)
    density = sun_density(evidence, estimate, model, sun_prior)
    region = smallest_region(density, grid.solid_angles)
    share = float(grid.solid_angles[region].sum() / grid.solid_angles.sum())
    split = split_density(albedo, specular_scale, albedo_prior)
    low, high = interval(-split[0], split[1], model.exposure_spread + model.unseen_spread * share)
    return SunPosterior(
        grid=grid,
        density=density,
        region=region,
        parts=region_parts(grid, density, region),
        sun_gain=evidence.gain,
        exposure_interval=(low * exposure, high * exposure),
        albedo_scale_interval=interval(*split, model.albedo_spread),
        clock_wrong=None if sun_prior is None else clock_wrong(evidence, sun_prior, model),
        is_seen=evidence.gain >= model.sun_gain if seen is None else seen,
        by_camera=evidence.camera_gain > CAMERA_SHARE * evidence.gain,
    )


def split_density(
    albedo: Float[Tensor, "3"], specular_scale: float | None, albedo_prior: Prior
) -> tuple[Float[Tensor, " k"], Float[Tensor, " k"]]:
    """(log s, p): how likely albedo is s times what was estimated; p sums to 1.

    Skin of albedo s a in light of 1 / s looks the same if its specular reflection is s times as
    strong too, so the priors alone say how likely s is: p(log s) ~ p_albedo(log a + log s)
    p_specular(log g + log s), the last where ``specular_scale`` (the strength g) was estimated.
    """
    shift = torch.linspace(-3.0, 3.0, 601, dtype=torch.float64)
    tried = albedo.log() + shift[:, None].to(albedo)
    if isinstance(albedo_prior, torch.nn.Module):  # on the solver's device
        tried = tried.to(next(albedo_prior.buffers()).device)
    level = albedo_prior.log_prob(tried).double().cpu()
    if specular_scale is not None:
        level = level - 0.5 * ((math.log(specular_scale) + shift) / SPECULAR_SPREAD) ** 2
    return shift, torch.softmax(level, 0)


def interval(
    logs: Float[Tensor, " k"], share: Float[Tensor, " k"], spread: float
) -> tuple[float, float]:
    """90 % of exp(x + e): x one of ``logs`` with its share, e normal with that spread."""
    at = torch.linspace(-6.0, 6.0, 1201, dtype=torch.float64)
    reached = torch.special.ndtr((at[:, None] - logs[None]) / spread) @ share
    low, high = (int((reached < q).sum()) for q in ((1 - SHARE) / 2, (1 + SHARE) / 2))
    return math.exp(float(at[low])), math.exp(float(at[min(high, len(at) - 1)]))
