"""The parametric sun + sky model: Preetham's sky, one lobe for the sun, ten parameters.

Thesis, eq. 5.6, after Lalonde & Matthews 2014::

    l(w) = f(w_sun, t) w_sky + C exp(kappa (<w_sun, w> - 1)) w_sun

Here both terms are normalised on the pixels, so that parameters keep their meaning everywhere:
f has a mean of 1 over the upper hemisphere, hence ``w_sky`` is the mean radiance of the sky, and
the lobe has an energy of 1 over the sphere, hence ``w_sun`` is the energy of the sun (radiance
times sr; half of it below the horizon when the sun stands on it).
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from skylight._modes import constant, full_precision, single
from skylight._module import Module
from skylight.errors import check_shape
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import (
    DirectionGrid,
    angles_from_direction,
    direction_from_angles,
    squared_chords,
)

TURBIDITY_BOUNDS = (1.7, 35.0)  # thesis, 5.3.3.3
KAPPA_BOUNDS = (8.0, 8192.0)  # thesis, 5.3.3.3
ZENITH_BOUNDS = (0.0, math.pi / 2)

# Perez' A..E as slope * turbidity + intercept (Preetham et al. 1999, appendix A.2).
_PEREZ = (
    (0.1787, -1.4630),
    (-0.3554, 0.4275),
    (-0.0227, 5.3251),
    (0.1206, -2.5771),
    (-0.0670, 0.3703),
)
# log and logit stay finite: parameters nearer than this to a bound are moved here by to_free.
_MIN_WEIGHT = 1e-6
_MIN_FRACTION = 1e-6
_MAX_LOG_WEIGHT = 40.0


def perez(
    cos_theta: Float[Tensor, "..."], gamma: Float[Tensor, "..."], turbidity: Float[Tensor, "..."]
) -> Float[Tensor, "..."]:
    """Perez' distribution ``(1 + A e^(B / cos theta)) (1 + C e^(D gamma) + E cos^2 gamma)``.

    theta is the zenith angle of the view, gamma its angle to the sun; arguments broadcast.
    Positive for all turbidities above 1.64.
    """
    a, b, c, d, e = (slope * turbidity + start for slope, start in _PEREZ)
    # at and below the horizon e^(B / cos theta) is e^(-inf): cos theta = 1e-3 says it finitely
    gradation = 1 + a * torch.exp(b / cos_theta.clamp(min=1e-3))
    return gradation * (1 + c * torch.exp(d * gamma) + e * torch.cos(gamma) ** 2)


_NAMES = "RGB of the sky, RGB of the sun, azimuth, zenith angle, turbidity, kappa"


class SunSky(Module):
    """Parameters ``(..., 10)`` to the radiance of (h, 4h) pixels of the upper hemisphere.

    ===== =========================================================================
    0:3   sky colour: mean radiance of the sky without the sun
    3:6   sun colour: energy of the sun lobe over the sphere
    6     azimuth of the sun, rad, any real number
    7     zenith angle of the sun, rad, 0 .. pi/2
    8     turbidity t, 1.7 .. 35
    9     kappa, sharpness of the sun lobe, 8 .. 8192 (its standard deviation is
          1 / sqrt(kappa): 20 deg .. 0.6 deg)
    ===== =========================================================================

    Its prior is :attr:`LightBundle.sunsky_prior <skylight.models.LightBundle>` of
    :func:`~skylight.models.load_bundle`, over free parameters without the azimuth
    (:func:`~skylight.models.without_azimuth`).
    """

    name = "sunsky"
    parameter_count = 10
    azimuth_index: int | None = 6

    sphere: Tensor
    log_solid_angle: Tensor

    def __init__(self, height: int = 32) -> None:
        super().__init__()
        self.grid = DirectionGrid.sky(height)
        full = DirectionGrid.latlong(2 * height)  # its upper half is the sky grid
        self.register_buffer("sphere", full.directions, persistent=False)
        self.register_buffer("log_solid_angle", full.solid_angles.log(), persistent=False)

    @property
    def bounds(self) -> tuple[Float[Tensor, " p"], Float[Tensor, " p"]]:
        low, high = _bounds(self.sphere.device).clone()
        return low, high

    def forward(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch n 3"]:
        """``f(w_sun, t) w_sky + g(w, kappa) w_sun``: radiance ``(..., n, 3)`` of ``(..., 10)``.

        Linear Rec.709, in the units of the two colours, in the order of ``grid.directions``; f is
        :meth:`sky_distribution`, g is :meth:`sun_lobe`. Differentiable.
        """
        params = self._checked(params)
        w_sky, w_sun = params[..., None, 0:3], params[..., None, 3:6]
        azimuth, zenith, turbidity, kappa = params[..., 6:].unbind(-1)
        sun = direction_from_angles(azimuth, zenith)
        sky, lobe = self.sky_distribution(sun, turbidity), self.sun_lobe(sun, kappa)
        return sky[..., None] * w_sky + lobe[..., None] * w_sun

    def _checked(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch p"]:
        check_shape("SunSky's parameters", params.shape, self.parameter_count, names=_NAMES)
        return single(params)

    def sky_distribution(
        self, sun: Float[Tensor, "*batch 3"], turbidity: Float[Tensor, "*batch"]
    ) -> Float[Tensor, "*batch n"]:
        """Perez' distribution divided by its mean over the upper hemisphere.

        The thesis' f is the luminance itself; it nearly vanishes with the zenith luminance near
        t = 1.7, where its weight would grow without bound.
        """
        upper = self.sphere[: len(self.grid)].to(sun.dtype)
        # Half-angle form of gamma: acos has infinite gradients at 0 and pi. The 1e-8 rounds off
        # the tip of e^(D gamma) at the sun, an error of 1e-4 rad there.
        gamma = 2 * torch.atan2(
            (squared_chords(sun, upper) + 1e-8).sqrt(), (squared_chords(sun, -upper) + 1e-8).sqrt()
        )
        value = perez(upper[:, 1], gamma, turbidity[..., None])
        solid_angle = self.log_solid_angle[: len(self.grid)].exp().to(sun.dtype)
        return value / ((value * solid_angle).sum(-1, keepdim=True) / (2 * math.pi))

    def sun_lobe(
        self, sun: Float[Tensor, "*batch 3"], kappa: Float[Tensor, "*batch"]
    ) -> Float[Tensor, "*batch n"]:
        """``exp(kappa (<s, w> - 1))`` with an energy of exactly 1 over the pixels of the sphere.

        The thesis' ``C = kappa / (2 pi - 2 pi e^(-2 kappa))`` normalises the continuous lobe:
        the same where pixels resolve it, but above kappa of about 1000 a lobe falls between the
        centres of pixels and its energy would depend on where the sun stands.
        """
        exponent = -0.5 * kappa[..., None] * squared_chords(sun, self.sphere.to(sun.dtype))
        total = torch.logsumexp(exponent + self.log_solid_angle.to(sun.dtype), dim=-1, keepdim=True)
        return torch.exp(exponent[..., : len(self.grid)] - total)

    def sun_direction(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch 3"]:
        """Unit vectors ``(..., 3)`` of azimuth and zenith angle."""
        params = self._checked(params)
        return direction_from_angles(params[..., 6], params[..., 7])

    def on_rows(self, height: int) -> "SunSky":
        """The model on ``height`` rows; both terms are normalised on those pixels."""
        if self.grid.layout == (height, 4 * height):
            return self
        return SunSky(height).to(self.sphere)

    def to_free(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch p"]:
        """log of the colours, azimuth as it is, logit of the zenith, log-logit of t and kappa.

        Colours below 1e-6, and the rest within 1e-6 of the range from a bound, move to there.
        """
        params = self._checked(params)
        return torch.cat(
            [
                params[..., :6].clamp(min=_MIN_WEIGHT).log(),
                params[..., 6:7],
                _logit(params[..., 7:8], *ZENITH_BOUNDS),
                _logit(params[..., 8:9].log(), *_log(TURBIDITY_BOUNDS)),
                _logit(params[..., 9:10].log(), *_log(KAPPA_BOUNDS)),
            ],
            dim=-1,
        )

    def from_free(self, free: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch p"]:
        """Inverse of :meth:`to_free`."""
        free = self._checked(free)
        turbidity = _sigmoid(free[..., 8:9], *_log(TURBIDITY_BOUNDS)).exp()
        kappa = _sigmoid(free[..., 9:10], *_log(KAPPA_BOUNDS)).exp()
        return torch.cat(
            [
                # a line search may try anything; e^40 is as wrong as infinity but finite
                free[..., :6].clamp(max=_MAX_LOG_WEIGHT).exp(),
                free[..., 6:7],
                _sigmoid(free[..., 7:8], *ZENITH_BOUNDS),
                # exp(log) can miss a bound by a rounding
                turbidity.clamp(*TURBIDITY_BOUNDS),
                kappa.clamp(*KAPPA_BOUNDS),
            ],
            dim=-1,
        )

    def starts(self) -> Float[Tensor, "s p"]:
        """The three weathers of :meth:`starts_towards` with the sun ahead, right, behind, left."""
        azimuth = torch.arange(4, dtype=torch.float64) * math.pi / 2
        directions = direction_from_angles(azimuth, torch.full_like(azimuth, math.pi / 4))
        return self.starts_towards(directions).flatten(0, 1)

    def starts_towards(self, directions: Float[Tensor, "d 3"]) -> Float[Tensor, "d k p"]:
        """Clear, hazy and overcast, each with a mean luminance of 1 (a high sun's lobe included).

        Directions below the horizon are moved up to it.
        """
        azimuth, zenith = angles_from_direction(directions.to(self.sphere))
        zenith = zenith.clamp(*ZENITH_BOUNDS)
        angles = torch.stack([azimuth, zenith], dim=-1)[:, None].expand(-1, len(_WEATHERS), 2)
        rows = []
        for sun_share, turbidity, kappa, sky_colour, sun_colour in _WEATHERS:
            sky, sun = self.sphere.new_tensor(sky_colour), self.sphere.new_tensor(sun_colour)
            sky = sky / luminance(sky) * (1 - sun_share)
            sun = sun / luminance(sun) * sun_share * 2 * math.pi
            rows.append(torch.cat([sky, sun, sky.new_tensor([turbidity, kappa])]))
        weather = torch.stack(rows).expand(len(directions), -1, -1)
        params = torch.cat([weather[..., :6], angles, weather[..., 6:]], dim=-1)
        return params.to(torch.get_default_dtype())


@constant()
def _bounds(device: torch.device) -> Float[Tensor, "2 p"]:
    low = [0.0] * 6 + [-math.inf, ZENITH_BOUNDS[0], TURBIDITY_BOUNDS[0], KAPPA_BOUNDS[0]]
    high = [math.inf] * 7 + [ZENITH_BOUNDS[1], TURBIDITY_BOUNDS[1], KAPPA_BOUNDS[1]]
    return torch.tensor([low, high], dtype=torch.float64, device=device)


# (share of the sun in the energy, turbidity, kappa, sky colour, sun colour). The clear sun's share
# is that of direct light on clear days; the colours are nominal linear-RGB tints.
_WEATHERS = (
    (0.75, 2.5, 4096.0, (0.6, 1.0, 1.7), (1.1, 1.0, 0.8)),
    (0.50, 6.0, 512.0, (0.8, 1.0, 1.3), (1.1, 1.0, 0.8)),
    (0.15, 10.0, 64.0, (0.95, 1.0, 1.1), (1.0, 1.0, 1.0)),
)


def fit_sunsky(
    sky: Float[Tensor, "b n 3"], model: SunSky | None = None, *, batch: int = 32
) -> Float[Tensor, "b p"]:
    """Parameters of the model that fit given skies: what a prior over parameters is built from.

    The sun stands at the brightest direction. Turbidity and kappa minimise the divergence
    ``sum_w dw (L log(L / l) - L + l)`` of luminance over a table of both (parabolas between its
    entries); it weighs the sun by its energy, where squares would see nothing else. The colours
    minimise the same divergence, whose minimum has exactly the energy of the given sky.
    Colours are at least 1e-4 of the mean luminance, so that their logarithms stay moderate.
    """
    model = SunSky() if model is None else model
    check_shape("SunSky's skies", sky.shape, len(model.grid), 3)
    with full_precision(model.sphere):
        parts = [_fit_batch(part, model) for part in sky.detach().to(model.sphere).split(batch)]
    return torch.cat(parts).to(sky.dtype)


def _fit_batch(sky: Float[Tensor, "b n 3"], model: SunSky) -> Float[Tensor, "b p"]:
    weight = model.grid.solid_angles.to(sky)
    layout = model.grid.layout
    assert layout is not None
    maps = [EnvironmentMap(radiance=one.reshape(*layout, 3).cpu()) for one in sky]
    sun = torch.stack([one.brightest_direction() for one in maps]).to(sky)
    azimuth, zenith = angles_from_direction(sun)
    count = len(sky)

    turbidity = torch.linspace(*_log(TURBIDITY_BOUNDS), 9, dtype=sky.dtype, device=sky.device)
    kappa = torch.linspace(*_log(KAPPA_BOUNDS), 11, dtype=sky.dtype, device=sky.device)
    skies = torch.stack([model.sky_distribution(sun, t.exp().expand(count)) for t in turbidity], 1)
    lobes = torch.stack([model.sun_lobe(sun, k.exp().expand(count)) for k in kappa], 1)
    value = luminance(sky)[:, None]
    # every turbidity with every kappa: most of the work, hence float32
    target, pixel, lobes = value.float(), weight.float(), lobes.float()
    scores = []
    for one in skies.float().split(1, dim=1):
        w_sky, w_sun = _energies(target, one, lobes, pixel, 6)
        fit = w_sky[..., None] * one + w_sun[..., None] * lobes
        scores.append(_divergence(target, fit, pixel))
    t_index, k_index = _table_minimum(torch.stack(scores, 1))
    best_t = _interpolate(turbidity, t_index.to(sky)).exp().clamp(*TURBIDITY_BOUNDS)
    best_k = _interpolate(kappa, k_index.to(sky)).exp().clamp(*KAPPA_BOUNDS)

    basis_sky = model.sky_distribution(sun, best_t)[:, None]
    basis_sun = model.sun_lobe(sun, best_k)[:, None]
    w_sky, w_sun = _energies(sky.mT, basis_sky, basis_sun, weight, 60)
    floor = 1e-4 * (value @ weight / (2 * math.pi)).clamp(min=1e-12)
    # colours, azimuth, zenith, turbidity, kappa; the horizon is the lowest a sun can stand
    angles = torch.stack([azimuth, zenith.clamp(*ZENITH_BOUNDS), best_t, best_k], 1)
    colours = torch.cat([w_sky.maximum(floor), w_sun.maximum(floor)], 1)
    return torch.cat([colours, angles], 1)


def _energies(
    target: Float[Tensor, "b c n"],
    sky: Float[Tensor, "b #c n"],
    lobe: Float[Tensor, "b #k n"],
    weight: Float[Tensor, " n"],
    steps: int,
) -> tuple[Float[Tensor, "b j"], Float[Tensor, "b j"]]:
    """(w_sky, w_sun): non-negative weights of two bases by Richardson-Lucy iteration.

    ``w <- w <basis, L / l> / <basis, 1>`` lowers the divergence at every step and, from the first
    on, gives the fit the energy of the target (Lucy 1974).
    """
    energy_sky, energy_lobe = sky @ weight, (lobe @ weight).clamp(min=1e-12)
    energy = target @ weight
    w_sky, w_lobe = 0.5 * energy / energy_sky, 0.5 * energy / energy_lobe
    for _ in range(steps):
        fit = w_sky[..., None] * sky + w_lobe[..., None] * lobe
        ratio = target / fit.clamp(min=1e-12) * weight
        w_sky = w_sky * (ratio * sky).sum(-1) / energy_sky
        w_lobe = w_lobe * (ratio * lobe).sum(-1) / energy_lobe
    return w_sky, w_lobe


def _divergence(
    target: Float[Tensor, "b #k n"],
    fit: Float[Tensor, "b k n"],
    weight: Float[Tensor, " n"],
) -> Float[Tensor, "b k"]:
    """``sum_w dw (L log(L / l) - L + l)``, 0 log 0 = 0."""
    log_ratio = (target.clamp(min=1e-12) / fit.clamp(min=1e-12)).log()
    return (target * log_ratio - target + fit) @ weight


def _table_minimum(
    scores: Float[Tensor, "b i j"],
) -> tuple[Float[Tensor, " b"], Float[Tensor, " b"]]:
    """Fractional indices of the minimum: a parabola along each axis through the lowest entry."""
    rows, columns = scores.shape[1:]
    flat = scores.flatten(1).argmin(1)
    i, j = flat // columns, flat % columns
    batch = torch.arange(len(scores), device=scores.device)

    def along(index: Tensor, size: int, line: Float[Tensor, "b s"]) -> Float[Tensor, " b"]:
        middle = index.clamp(1, size - 2)
        low, mid, high = (line[batch, middle + o] for o in (-1, 0, 1))
        bend = low - 2 * mid + high
        offset = torch.where(bend > 0, 0.5 * (low - high) / bend.clamp(min=1e-30), 0.0)
        inside = (index == middle).to(offset)
        return index + inside * offset.clamp(-0.5, 0.5)

    return along(i, rows, scores[batch, :, j]), along(j, columns, scores[batch, i])


def _interpolate(table: Float[Tensor, " s"], index: Float[Tensor, " b"]) -> Float[Tensor, " b"]:
    """Entry of an evenly spaced table at a fractional index."""
    return table[0] + index * (table[1] - table[0])


def _log(bounds: tuple[float, float]) -> tuple[float, float]:
    return math.log(bounds[0]), math.log(bounds[1])


def _logit(x: Float[Tensor, "*s"], low: float, high: float) -> Float[Tensor, "*s"]:
    return torch.logit((x - low) / (high - low), eps=_MIN_FRACTION)


def _sigmoid(x: Float[Tensor, "*s"], low: float, high: float) -> Float[Tensor, "*s"]:
    return low + (high - low) * torch.sigmoid(x)
