"""Metrics of estimated illumination (thesis, 5.5.1), with their normalisation.

The thesis fixes the scale "by mapping the average image intensity to 1 and the sum over the
light probe to 1", and does not say whether a prediction is scaled by its own sum or by the
truth's. Here:

- shading: render and truth are both divided by the *truth's* mean, so a wrong exposure counts
  (si-RMSE forgives it);
- lighting: each probe is divided by *its own* sum (``align_scale=True``), or both by the truth's.

All sums are taken in float64.
"""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from skylight.errors import InputError
from skylight.imaging._colour import linear_to_srgb
from skylight.sphere._envmap import SUN_REGION_RAD, EnvironmentMap, luminance
from skylight.sphere._frame import angle_between

_BLACK_PROBE = "the true light probe is black: errors relative to its sum mean nothing"
SSIM_WINDOW = 11  # taps of the Gaussian window, sigma 1.5 pixels: Wang et al. 2004, III.C


def mae(pred: Float[Tensor, "*s 3"], true: Float[Tensor, "*s 3"]) -> float:
    """``mean |p - t| / mean t``, over pixels and channels."""
    p, t = _over_true_mean(pred, true)
    return float((p - t).abs().mean())


def rmse(pred: Float[Tensor, "*s 3"], true: Float[Tensor, "*s 3"]) -> float:
    """sqrt(mean (p - t)^2) / mean t, over pixels and channels."""
    p, t = _over_true_mean(pred, true)
    return float((p - t).square().mean().sqrt())


def si_rmse(pred: Float[Tensor, "*s 3"], true: Float[Tensor, "*s 3"]) -> float:
    """min over a of rmse(a p, t), with a = <p, t> / <p, p>: one scale for all channels.

    Scale-invariant error of Barron and Malik 2012, relative to the truth's mean.
    """
    p, t = _over_true_mean(pred, true)
    energy = p.square().sum()
    scale = (p * t).sum() / energy if energy > 0 else torch.zeros_like(energy)
    return float((scale * p - t).square().mean().sqrt())


def ssim(
    pred: Float[Tensor, "h w 3"],
    true: Float[Tensor, "h w 3"],
    mask: Bool[Tensor, "h w"] | None = None,
    *,
    white: float | None = None,
) -> float:
    """Structural similarity of the pictures as shown, averaged within the mask and over channels.

    Both renders are divided by one ``white``, by default the 98 % quantile of the truth's luminance
    within the mask, clamped to [0, 1] and sRGB-encoded (data range 1); outside the mask both are
    black. Gaussian window of 11 pixels, sigma 1.5, K1 = 0.01, K2 = 0.03 (Wang et al. 2004).
    """
    from kornia.metrics import ssim as ssim_map  # slow to import

    if min(true.shape[:2]) < SSIM_WINDOW:
        raise InputError(f"SSIM needs {SSIM_WINDOW} pixels a side, got {tuple(true.shape[:2])}")
    mask = torch.ones(true.shape[:2], dtype=torch.bool) if mask is None else mask
    if white is None:
        level = luminance(true.double())[mask].sort().values
        white = float(level[round(0.98 * (len(level) - 1))])
    white = max(white, 1e-30)
    shown = [
        (linear_to_srgb((x.double() / white).clamp(0, 1)) * mask[..., None]).movedim(-1, 0)[None]
        for x in (pred, true)
    ]
    score = ssim_map(shown[0], shown[1], window_size=SSIM_WINDOW, max_val=1.0)
    return float(score[0].mean(0)[mask].mean())


def shading_metrics(
    pred: Float[Tensor, "h w 3"],
    true: Float[Tensor, "h w 3"],
    mask: Bool[Tensor, "h w"] | None = None,
) -> dict[str, float]:
    """``mae``, ``rmse``, ``si_rmse`` and ``ssim`` of two linear renders, within the mask."""
    mask = torch.ones(true.shape[:2], dtype=torch.bool) if mask is None else mask
    if not mask.any():
        raise InputError("the mask holds no pixel to compare")
    p, t = pred[mask], true[mask]
    return {
        "mae": mae(p, t),
        "rmse": rmse(p, t),
        "si_rmse": si_rmse(p, t),
        "ssim": ssim(pred, true, mask),
    }


def full_dw_mae(pred: EnvironmentMap, true: EnvironmentMap, *, align_scale: bool = True) -> float:
    """Mean over channels of ``sum_w |p(w) - t(w)| dw`` over the whole map, after normalisation.

    Normalised so that the channel mean of sum_w t(w) dw is 1, and the same for p where
    ``align_scale``; otherwise p is divided by the truth's sum. A prediction without light has
    no scale to align and scores 1. From 0 to 2 where aligned and p >= 0 (truncate SH first).
    """
    return _region_error(pred, true, torch.ones_like(_upper(true)), align_scale)


def sky_dw_mae(pred: EnvironmentMap, true: EnvironmentMap, *, align_scale: bool = True) -> float:
    """:func:`full_dw_mae`'s sum over the upper half outside :func:`sun_region`."""
    return _region_error(pred, true, _upper(true) & ~sun_region(true), align_scale)


def sun_dw_mae(pred: EnvironmentMap, true: EnvironmentMap, *, align_scale: bool = True) -> float:
    """How the suns differ in shape and intensity, wherever they stand.

    The 13 degrees round *each map's own* brightest direction are cut into cells, four rings (up
    to 4, 7, 10 and 13 degrees) by eight sectors, sector 0 towards the zenith; the energies
    sum_w p(w) dw per cell are compared, ``sum |E_p - E_t|``, normalised like :func:`full_dw_mae`.

    The thesis (5.5.1) crops "13 degrees around the brightest point in the sky probe"; that its
    autoencoder scores 0.15 with a mean sun angle of 24 degrees (table 5.2) shows that each probe
    has its own crop: position is what the sun angle measures. Cells instead of pixels, because
    whether a sun of half a degree falls on one pixel or between four is no difference of light.
    See :func:`sun_dw_mae_fixed` for pixels at the true sun.
    """
    pred_cells, true_cells = _sun_cells(pred), _sun_cells(true)
    true_sum = _total(true)
    if true_sum <= 0:
        raise InputError(_BLACK_PROBE)
    pred_sum = _total(pred) if align_scale else true_sum
    difference = pred_cells / (pred_sum if pred_sum > 0 else true_sum) - true_cells / true_sum
    return float(difference.abs().sum(0).mean())


def sun_dw_mae_fixed(
    pred: EnvironmentMap, true: EnvironmentMap, *, align_scale: bool = True
) -> float:
    """:func:`full_dw_mae`'s sum over :func:`sun_region` of the truth, pixel by pixel.

    Counts a sun that is displaced by one pixel (2.8 degrees on 64 x 128) twice: as missing here
    and as wrong there. A map without any sun scores better than one with a sun 3 degrees off.
    """
    return _region_error(pred, true, sun_region(true), align_scale)


def sun_angle_deg(pred: EnvironmentMap, true: EnvironmentMap) -> float:
    """Angle between the brightest directions of the two skies, in degrees."""
    return math.degrees(
        float(angle_between(pred.brightest_direction(), true.brightest_direction()))
    )


def lighting_metrics(
    pred: EnvironmentMap, true: EnvironmentMap, *, align_scale: bool = True
) -> dict[str, float]:
    """``full_dw_mae``, ``sky_dw_mae``, ``sun_dw_mae``, ``sun_dw_mae_fixed``, ``sun_angle_deg``.

    The last three mean something only where the truth shows a sun; leave overcast skies out of
    their averages, as the thesis does.
    """
    return {
        "full_dw_mae": full_dw_mae(pred, true, align_scale=align_scale),
        "sky_dw_mae": sky_dw_mae(pred, true, align_scale=align_scale),
        "sun_dw_mae": sun_dw_mae(pred, true, align_scale=align_scale),
        "sun_dw_mae_fixed": sun_dw_mae_fixed(pred, true, align_scale=align_scale),
        "sun_angle_deg": sun_angle_deg(pred, true),
    }


def sun_region(environment: EnvironmentMap) -> Bool[Tensor, " n"]:
    """Sky directions within 13 degrees of the brightest one (thesis, 5.5.1).

    Read as a radius: a cap of 2 pi (1 - cos 13 deg) = 0.161 sr, less what lies below the horizon.
    """
    directions = environment.grid.directions
    peak = environment.brightest_direction()
    return (angle_between(directions, peak) < SUN_REGION_RAD) & _upper(environment)


_RINGS_RAD = tuple(math.radians(r) for r in (4.0, 7.0, 10.0, 13.0))
_SECTORS = 8


def _sun_cells(environment: EnvironmentMap) -> Float[Tensor, "cells 3"]:
    """Energy per ring and sector round the brightest direction, above the horizon."""
    grid = environment.grid
    peak = environment.brightest_direction()
    east = torch.linalg.cross(torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64), peak)
    # straight above, sectors start at the world's +X
    fallback = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)
    east = east / east.norm() if float(east.norm()) > 1e-6 else fallback
    up = torch.linalg.cross(peak, east)
    turn = torch.atan2(grid.directions @ east, grid.directions @ up) / (2 * math.pi)
    # the sectors' borders lie between the principal directions
    sector = torch.floor(turn * _SECTORS + 0.5).long() % _SECTORS
    angle = angle_between(grid.directions, peak)
    ring = torch.bucketize(angle, torch.tensor(_RINGS_RAD, dtype=torch.float64))
    inside = (angle < SUN_REGION_RAD) & _upper(environment)
    # a sun that fills the innermost ring has no direction there: one cell for all of it
    cell = torch.where(ring == 0, 0, ring * _SECTORS + sector)[inside]
    energy = (environment.flat.detach().cpu().double() * grid.solid_angles[:, None])[inside]
    return torch.zeros(4 * _SECTORS, 3, dtype=torch.float64).index_add_(0, cell, energy)


def _total(environment: EnvironmentMap) -> float:
    """Mean over channels of sum_w L(w) dw."""
    return float((environment.grid.solid_angles @ environment.flat.detach().cpu().double()).mean())


def _upper(environment: EnvironmentMap) -> Bool[Tensor, " n"]:
    return environment.grid.directions[:, 1] > 0


def _region_error(
    pred: EnvironmentMap, true: EnvironmentMap, region: Bool[Tensor, " n"], align_scale: bool
) -> float:
    if pred.layout != true.layout:
        raise InputError(f"maps of {pred.layout} and {true.layout} pixels: resize one of them")
    weight = true.grid.solid_angles
    p, t = pred.flat.detach().cpu().double(), true.flat.detach().cpu().double()
    true_sum = float((weight @ t).mean())
    if true_sum <= 0:
        raise InputError(_BLACK_PROBE)
    pred_sum = float((weight @ p).mean()) if align_scale else true_sum
    difference = (p / (pred_sum if pred_sum > 0 else true_sum) - t / true_sum).abs()
    return float((weight[region] @ difference[region]).mean())


def _over_true_mean(
    pred: Float[Tensor, "*s 3"], true: Float[Tensor, "*s 3"]
) -> tuple[Float[Tensor, "*s 3"], Float[Tensor, "*s 3"]]:
    p, t = pred.detach().double(), true.detach().double()
    mean = t.mean()
    if not mean > 0:
        raise InputError("the true render is black: errors relative to its mean mean nothing")
    return p / mean, t / mean
