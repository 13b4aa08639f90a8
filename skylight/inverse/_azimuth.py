"""The azimuth rotation of a light probe against a photograph, by the face in it (thesis, 5.4.2)."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from scipy.signal import find_peaks
from torch import Tensor

from skylight.errors import InputError
from skylight.sphere._envmap import EnvironmentMap
from skylight.transport._observation import Observation

# A dip counts as a minimum where it is deeper than this part of the curve's range: noise makes
# shallower ones.
PROMINENCE = 0.02
MOST_MINIMA = 6
FLAT = 1e-5  # of the error: less of a difference is rounding


@dataclass(frozen=True, kw_only=True)
class AzimuthCurve:
    """Errors of the relit face for every azimuth rotation of a probe by whole columns.

    ``azimuth_deg`` (w,) ascends from -180, positive to the right; ``error`` (w,) is the si-RMSE,
    relative to the face's mean. ``minima`` are indices into both, the best first.
    """

    azimuth_deg: Float[Tensor, " w"]
    error: Float[Tensor, " w"]
    minima: tuple[int, ...]


def azimuth_curve(observation: Observation, probe: EnvironmentMap) -> AzimuthCurve:
    """si-RMSE of the face relit by a probe in every azimuth, column by column.

    For each turn k the relit face is ``p = a_c (T l_k)_c + g (G l_k)_c`` with the albedo a and the
    specular scale g, both times the exposure, that fit best; g is 0 where the observation
    has no specular reflection. White balance goes into a. Its error is
    ``sqrt(mean_c sum w (p - t)^2)`` over ``mean_c sum w t``, with the pixels t and weights w that
    sum to 1.

    All turns are one product of T, and one of G, with (n, w * 3). The probe is brought to the
    transport's grid of w columns: 128 of 2.8 degrees for an estimate's.
    """
    height, width = _layout(observation)
    radiance = probe.resize(height).radiance
    turns = torch.arange(width) - width // 2
    lights = torch.stack([radiance.roll(int(k), dims=1) for k in turns], dim=2)
    fit = _fit(observation, lights.reshape(height * width, width, 3))
    if not bool((fit.albedo > 0).any()):
        raise InputError("the probe throws no light on the face, however it is turned")
    spread = float(fit.error.max() - fit.error.min())
    if spread <= FLAT * float(fit.error.max()):
        raise InputError("the probe throws the same light from all sides: it has no azimuth")
    return AzimuthCurve(
        azimuth_deg=turns.double() * (360 / width),
        error=fit.error,
        minima=local_minima(fit.error, prominence=PROMINENCE * spread),
    )


def local_minima(curve: Float[Tensor, " w"], *, prominence: float) -> tuple[int, ...]:
    """Indices of a closed curve's local minima, the lowest first, at most six.

    A minimum counts if its prominence is at least ``prominence`` on both sides. Of a flat minimum
    the middle is taken.
    """
    count = len(curve)
    # three times round, so that the ends have neighbours
    found, _ = find_peaks(-curve.repeat(3).numpy(), prominence=prominence)
    inside = [int(i) - count for i in found if count <= i < 2 * count]
    return tuple(sorted(inside, key=lambda i: float(curve[i]))[:MOST_MINIMA])


def relit_face(
    observation: Observation, probe: EnvironmentMap, azimuth_deg: float
) -> Float[Tensor, "m 3"]:
    """The face's pixels in the turned probe, with the albedo and specular scale that suit best."""
    turned = probe.rotate_azimuth(math.radians(azimuth_deg)).resize(_layout(observation)[0])
    return _fit(observation, turned.flat[:, None]).relit[:, 0].float()


@dataclass(frozen=True, kw_only=True)
class _Fit:
    """Relit faces of w lights with what suits each best."""

    relit: Float[Tensor, "m w 3"]
    albedo: Float[Tensor, "w 3"]
    error: Float[Tensor, " w"]


def _fit(observation: Observation, lights: Float[Tensor, "n w 3"]) -> _Fit:
    """Least squares for each light: three albedos and one specular scale, none below 0."""
    weights = observation.weights
    if observation.clipped is not None:  # bounds say nothing to least squares
        weights = weights * ~observation.clipped
    share = (weights / weights.sum()).double()
    seen = observation.pixels.double()

    def shading(matrix: Float[Tensor, "m n"]) -> Float[Tensor, "m w 3"]:
        return (matrix @ lights.flatten(1)).double().unflatten(1, lights.shape[1:])

    def product(a: Float[Tensor, "m _ 3"], b: Float[Tensor, "m _ 3"]) -> Float[Tensor, "_ 3"]:
        return torch.einsum("m,mwc->wc", share, a * b)

    target = seen[:, None]
    diffuse = shading(observation.transport.matrix)
    energy, both = product(diffuse, diffuse).clamp(min=1e-300), product(diffuse, target)
    albedo, relit = both / energy, torch.zeros_like(diffuse)
    if observation.specular is not None:
        shine = shading(observation.specular.matrix)
        # what of the specular reflection, and of the picture, no albedo explains
        mixed = product(diffuse, shine)
        left = (product(shine, target) - mixed * albedo).sum(1)
        own = (product(shine, shine) - mixed.square() / energy).sum(1)
        strength = (left / own.clamp(min=1e-300)).clamp(min=0)[:, None]
        albedo = (albedo - strength * mixed / energy).clamp(min=0)
        relit = strength * shine
    relit = albedo * diffuse + relit
    squared = product(relit - target, relit - target).mean(1)
    return _Fit(relit=relit, albedo=albedo, error=squared.sqrt() / (share @ seen).mean())


def _layout(observation: Observation) -> tuple[int, int]:
    layout = observation.transport.grid.layout
    assert layout is not None
    return layout
