"""Lamps in smooth ambient light: a light model for rooms, studios and streets at night.

    l(w) = A(w) + 4 pi sum_k e_k c_k g(w; d_k, s_k),

with A ambient light whose logarithm is a field of spherical harmonics of degree 2 and whose mean
luminance is 1, g a von Mises-Fisher lobe of energy 1 about the direction d_k with a spread of s_k
rad per axis, c_k the lamp's colour (of luminance 1) and e_k its energy relative to the ambient
light's. Never negative, on the whole sphere, and smooth in all its parameters.

The prior is made of what is sensible in rooms. Nothing of it is learnt from environment maps.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from skylight._modes import full_precision, on_cpu, single
from skylight._module import Module
from skylight.errors import check_shape
from skylight.models._base import ParametricLight, draws
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._envmap import luminance
from skylight.sphere._frame import squared_chords

AMBIENT_PARAMETERS, LAMP_PARAMETERS = 16, 7
# Standard deviations over the sphere of the fields of log luminance of degree 1 and 2, and by how
# much ceilings are brighter than floors: e^(2 x 0.3) with reflectances of 0.7 and 0.2 and lamps on
# either side.
AMBIENT_SPREADS = 0.15, 0.15
UPWARD = 0.3
# Of the log of red and of blue against green: all ambient light, and its field of degree 1. A
# camera has balanced most of it.
AMBIENT_CHROMA, AMBIENT_CHROMA_FIELD = 0.2, 0.15
LAMP_CHROMA = 0.2  # of a lamp against the ambient light's mean: tungsten beside daylight has 0.5
# Medians and standard deviations of log e_k and log s_k: a bulb seen from across a room is a
# degree wide, a window or a softbox 20
LAMP_ENERGY, LAMP_ENERGY_SPREAD = 0.5, 1.2
# Of e_k: a lamp with ten elevenths of all light. One behind the head that only grazes it may have
# any energy, as far as the face tells.
MOST_ENERGY = 10.0
LAMP_WIDTH_RAD, LAMP_WIDTH_SPREAD = math.radians(8.0), 0.7
WIDTH_BOUNDS_RAD = math.radians(3.0), math.radians(40.0)  # half a cell of 32 rows; a wall
LAMP_HEIGHT = 1.0  # p(d) ~ e^(h d_y): lamps above are e^2 times as likely as below
_NAMES = f"{AMBIENT_PARAMETERS} of the ambient light, {LAMP_PARAMETERS} of each lamp"
LONGEST = 6.0  # standard deviations: a line search may try anything


@dataclass(frozen=True, kw_only=True)
class Lamps:
    """The lamps of lights: ``directions`` (b,k,3) unit, ``energies`` e (b,k), ``widths_rad`` s
    (b,k), ``colours`` c (b,k,3)."""

    directions: Float[Tensor, "*b k 3"]
    energies: Float[Tensor, "*b k"]
    widths_rad: Float[Tensor, "*b k"]
    colours: Float[Tensor, "*b k 3"]


class LampsLight(ParametricLight):
    """Parameters ``(..., 16 + 7 k)`` to radiance on ``height`` rows of the sphere, of k lamps.

    All are standard normal beforehand but for the directions::

        0:8    log luminance of the ambient light, degrees 1 and 2
        8:16   log of its red, then of its blue against green, degrees 0 and 1
        then for each lamp
        0:3    direction, of any length but 0
        3, 4   log energy (of 1 / (1 / e - 1 / 10): e stays below 10), log width
        5, 6   log of its red and of its blue against green

    Its prior is :class:`LampsPrior` of as many lamps, over the same numbers.
    """

    parameter_names = _NAMES
    basis: Tensor
    directions: Tensor
    log_solid_angle: Tensor
    tone_scale: Tensor
    chroma_scale: Tensor

    @on_cpu
    def __init__(self, count: int, height: int = 32) -> None:
        if count < 0:
            raise ValueError(f"{count} lamps: give 0 or more")
        super().__init__(AMBIENT_PARAMETERS + LAMP_PARAMETERS * count, height, sphere=True)
        self.count = count
        self.name = "lamps"
        basis = harmonics.evaluate(self.grid.directions, 2)
        self.register_buffer("basis", basis, persistent=False)
        self.register_buffer("directions", self.grid.directions, persistent=False)
        self.register_buffer("log_solid_angle", self.grid.solid_angles.log(), persistent=False)
        self.register_buffer("tone_scale", _tone_scale(), persistent=False)
        self.register_buffer("chroma_scale", _chroma_scale(), persistent=False)

    def on_rows(self, height: int) -> "LampsLight":
        """The model on ``height`` rows."""
        return LampsLight(self.count, height).to(self.basis)

    def forward(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch n 3"]:
        """``A(w) + 4 pi sum_k e_k c_k g(w; d_k, s_k)``: radiance ``(..., n, 3)``.

        Linear Rec.709, relative to ambient light of mean luminance 1, in the order of
        ``grid.directions``. Differentiable.
        """
        self.check_parameters(params)
        params = single(params)
        with full_precision(params):
            radiance = self.ambient(params)
            if self.count == 0:
                return radiance
            lamps = self.lamps(params)
            energy = 4 * math.pi * lamps.energies[..., None] * lamps.colours
            return radiance + torch.einsum("...kn,...kc->...nc", self.lobes(lamps), energy)

    def ambient(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch n 3"]:
        """A of the module's text."""
        params = params[..., :AMBIENT_PARAMETERS].clamp(-LONGEST, LONGEST)
        basis = self.basis.to(params.dtype)
        tone = params[..., :8] * self.tone_scale.to(params.dtype)
        # the field of degree 1 that is y has a mean of 0 and UPWARD at the zenith
        level = tone @ basis[:, 1:].T + UPWARD * self.directions[:, 1].to(params.dtype)
        chroma = params[..., 8:].unflatten(-1, (2, 4)) * self.chroma_scale.to(params.dtype)
        red, blue = (chroma @ basis[:, :4].T).unbind(-2)
        colours = torch.stack([level + red, level, level + blue], -1).exp()
        share = self.log_solid_angle.to(params.dtype).exp() / (4 * math.pi)
        mean = luminance(colours) @ share
        return colours / mean[..., None, None]

    def lamps(self, params: Float[Tensor, "*batch p"]) -> Lamps:
        """What the parameters mean."""
        each = params[..., AMBIENT_PARAMETERS:].unflatten(-1, (self.count, LAMP_PARAMETERS))
        rest = each[..., 3:].clamp(-LONGEST, LONGEST)
        red, blue = (LAMP_CHROMA * rest[..., 2:]).unbind(-1)
        colours = torch.stack([red, torch.zeros_like(red), blue], -1).exp()
        widths = LAMP_WIDTH_RAD * (LAMP_WIDTH_SPREAD * rest[..., 1]).exp()
        return Lamps(
            directions=nn.functional.normalize(each[..., :3], dim=-1),
            energies=1
            / (1 / MOST_ENERGY + (-LAMP_ENERGY_SPREAD * rest[..., 0]).exp() / LAMP_ENERGY),
            widths_rad=widths.clamp(*WIDTH_BOUNDS_RAD),
            colours=colours / luminance(colours)[..., None],
        )

    @staticmethod
    def facing(widths_rad: Float[Tensor, "*s"]) -> Float[Tensor, "*s"]:
        """Irradiance of a surface that faces a lamp of energy 1: the mean of max(cos, 0) over g.

        ``(k - 1 + e^-k) / (k (1 - e^-2k))`` with ``k = 1 / s^2``.
        """
        sharpness = widths_rad**-2
        return (sharpness - 1 + (-sharpness).exp()) / (sharpness * -torch.expm1(-2 * sharpness))

    def lobes(self, lamps: Lamps) -> Float[Tensor, "*batch k n"]:
        """g of each lamp, with an energy of exactly 1 over the grid's cells."""
        chords = squared_chords(lamps.directions, self.directions.to(lamps.directions.dtype))
        exponent = -0.5 * chords / lamps.widths_rad[..., None] ** 2
        total = torch.logsumexp(
            exponent + self.log_solid_angle.to(exponent.dtype), -1, keepdim=True
        )
        return torch.exp(exponent - total)

    def starts(self) -> Float[Tensor, "s p"]:
        """Lamps above, on the camera's side, all round: one start."""
        azimuth = 2 * math.pi * torch.arange(self.count, dtype=torch.float64) / max(self.count, 1)
        around = torch.stack([azimuth.sin(), torch.ones_like(azimuth), azimuth.cos()], 1)
        energies = torch.full((1, self.count), 0.3 / max(self.count, 1))
        return self.starts_at(nn.functional.normalize(around, dim=1)[None], energies)[0, :1]

    def starts_towards(self, directions: Float[Tensor, "d 3"]) -> Float[Tensor, "d k p"]:
        """All lamps there: weak and strong ones, narrow and wide."""
        there = directions[:, None].expand(-1, self.count, -1)
        return self.starts_at(there, torch.full(there.shape[:2], 0.35 / max(self.count, 1)))

    def starts_at(
        self, directions: Float[Tensor, "s k 3"], energies: Float[Tensor, "s k"]
    ) -> Float[Tensor, "s c p"]:
        """Lamps there, of those energies (above 0) or half of them, narrow and wide."""
        params = self.log_solid_angle.new_zeros(len(directions), 4, self.parameter_count)
        each = params[..., AMBIENT_PARAMETERS:].unflatten(-1, (self.count, LAMP_PARAMETERS))
        each[..., :3] = directions.to(params)[:, None]
        half = torch.stack([energies, energies, energies / 2, energies / 2], 1).to(params)
        below = 1 / half.clamp(max=0.9 * MOST_ENERGY) - 1 / MOST_ENERGY
        each[..., 3] = -(LAMP_ENERGY * below).log() / LAMP_ENERGY_SPREAD
        each[..., 4] = params.new_tensor([0.0, 1.3, 0.0, 1.3])[:, None]
        return params.to(torch.get_default_dtype())


class LampsPrior(Module):
    """Density of :class:`LampsLight`'s parameters: normal, and directions by their height.

    A direction's length, which means nothing, is 1 with a standard deviation of 0.1.
    """

    like: Tensor

    def __init__(self, count: int) -> None:
        super().__init__()
        self.count = count
        self.parameter_count = AMBIENT_PARAMETERS + LAMP_PARAMETERS * count
        self.register_buffer("like", torch.empty(0), persistent=False)  # where samples are made

    def log_prob(self, x: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch"]:
        """Natural logarithm of the density, differentiable in x."""
        check_shape("LampsPrior's parameters", x.shape, self.parameter_count, names=_NAMES)
        x = single(x)
        ambient = x[..., :AMBIENT_PARAMETERS]
        each = x[..., AMBIENT_PARAMETERS:].unflatten(-1, (self.count, LAMP_PARAMETERS))
        length = each[..., :3].norm(dim=-1)
        up = each[..., 1] / length.clamp(min=1e-12)
        sphere = 4 * math.pi * math.sinh(LAMP_HEIGHT) / LAMP_HEIGHT
        towards = LAMP_HEIGHT * up - math.log(sphere) + _log_normal((length - 1) / 0.1)
        towards = towards - math.log(0.1) - 2 * length.clamp(min=1e-12).log()
        rest = _log_normal(each[..., 3:]).sum((-2, -1))
        return _log_normal(ambient).sum(-1) + rest + towards.sum(-1)

    def sample(
        self, shape: int | Sequence[int] = (), generator: torch.Generator | None = None
    ) -> Float[Tensor, "*shape p"]:
        """Independent draws ``(*shape, p)``, n of them for ``shape=n`` and one for none.

        In the module's dtype and on its device (``.to``), where ``generator`` lives too.
        """
        shape, where = draws(shape), {"dtype": self.like.dtype, "device": self.like.device}
        x = torch.randn(*shape, self.parameter_count, generator=generator, **where)
        each = x[..., AMBIENT_PARAMETERS:].unflatten(-1, (self.count, LAMP_PARAMETERS))
        uniform = torch.rand(*shape, self.count, 2, generator=generator, **where)
        # the height's distribution function is (e^(h y) - e^-h) / (e^h - e^-h)
        low, high = math.exp(-LAMP_HEIGHT), math.exp(LAMP_HEIGHT)
        up = (low + uniform[..., 0] * (high - low)).log() / LAMP_HEIGHT
        azimuth, level = 2 * math.pi * uniform[..., 1], (1 - up.square()).clamp(min=0).sqrt()
        towards = torch.stack([level * azimuth.sin(), up, level * azimuth.cos()], -1)
        each[..., :3] = towards * (1 + 0.1 * each[..., :1])
        return x


def _log_normal(x: Float[Tensor, "*s"]) -> Float[Tensor, "*s"]:
    return -0.5 * (x.square() + math.log(2 * math.pi))


def _tone_scale() -> Float[Tensor, "8"]:
    """Standard deviations of the coefficients: a field of degree l has 2 l + 1 of them."""
    one, two = (s * math.sqrt(4 * math.pi / (2 * n + 1)) for n, s in enumerate(AMBIENT_SPREADS, 1))
    return torch.tensor([one] * 3 + [two] * 5, dtype=torch.float64, device="cpu")


def _chroma_scale() -> Float[Tensor, "4"]:
    whole = AMBIENT_CHROMA * math.sqrt(4 * math.pi)
    field = AMBIENT_CHROMA_FIELD * math.sqrt(4 * math.pi / 3)
    return torch.tensor([whole] + [field] * 3, dtype=torch.float64, device="cpu")
