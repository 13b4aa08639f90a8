"""Lamps as lobes: the part that light models with a few distinct lights have in common.

    l(w) = A(w) + 4 pi sum_k e_k c_k g(w; d_k, s_k),

with A smooth light whose mean luminance is 1, g a von Mises-Fisher lobe of energy 1 about the
direction d_k with a spread of s_k rad per axis, c_k the lamp's colour (of luminance 1) and e_k its
energy relative to the smooth light's. Never negative, and smooth in all its parameters.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from skylight._modes import full_precision, single
from skylight.models._base import ParametricLight
from skylight.sphere._envmap import LUMINANCE, luminance
from skylight.sphere._frame import squared_chords

LAMP_PARAMETERS = 7
LAMP_CHROMA = 0.2  # of a lamp against the ambient light's mean: tungsten beside daylight has 0.5
# Medians and standard deviations of log e_k and log s_k: a bulb seen from across a room is a
# degree wide, a window or a softbox 20
LAMP_ENERGY, LAMP_ENERGY_SPREAD = 0.5, 1.2
# Of e_k: a lamp with ten elevenths of all light. One behind the head that only grazes it may have
# any energy, as far as the face tells.
MOST_ENERGY = 10.0
LAMP_WIDTH_RAD, LAMP_WIDTH_SPREAD = math.radians(8.0), 0.7
WIDTH_BOUNDS_RAD = math.radians(1.0), math.radians(40.0)  # the narrowest of those learnt; a wall
LONGEST = 6.0  # standard deviations: a line search may try anything


@dataclass(frozen=True, kw_only=True)
class Lamps:
    """The lamps of lights: ``directions`` (b,k,3) unit, ``energies`` e (b,k), ``widths_rad`` s
    (b,k), ``colours`` c (b,k,3)."""

    directions: Float[Tensor, "*b k 3"]
    energies: Float[Tensor, "*b k"]
    widths_rad: Float[Tensor, "*b k"]
    colours: Float[Tensor, "*b k 3"]


class LampedLight(ParametricLight):
    """Parameters ``(..., a + 7 k)`` to radiance on the sphere: a for A, then for each of k lamps::

        0:3    direction, of any length but 0
        3, 4   log energy (of 1 / (1 / e - 1 / 10): e stays below 10), log width
        5, 6   log of its red and of its blue against green

    The last four are about standard normal. What derives from this says what A is (:meth:`ambient`,
    of mean luminance 1), and of how many parameters.
    """

    log_solid_angle: Tensor

    def __init__(self, ambient_parameters: int, count: int, height: int, **options: int) -> None:
        if count < 0:
            raise ValueError(f"{count} lamps: give 0 or more")
        size = ambient_parameters + LAMP_PARAMETERS * count
        super().__init__(size, height, sphere=True, **options)  # type: ignore[arg-type]
        self.ambient_parameters, self.count = ambient_parameters, count
        self.register_buffer("directions", self.grid.directions, persistent=False)
        self.register_buffer("log_solid_angle", self.grid.solid_angles.log(), persistent=False)

    def ambient(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch n 3"]:
        """A of the module's text."""
        raise NotImplementedError

    def on_rows(self, height: int) -> "LampedLight":
        """The model on ``height`` rows."""
        raise NotImplementedError

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

    def ambient_log_slopes(self, params: Float[Tensor, "b p"]) -> Float[Tensor, "#b a 3 n"]:
        """Derivatives of log A, up to what scales A, along each of its parameters."""
        raise NotImplementedError

    @torch.no_grad()
    def slopes(self, params: Float[Tensor, "b p"]) -> Float[Tensor, "b p n 3"]:
        """Derivatives of :meth:`forward` along each parameter, in closed form.

        Of ``A = E / <Y(E)>`` with log E of slopes G they are ``A (G - <Y(A G)>)``, Y luminance.
        """
        params = single(params)
        with full_precision(params):
            ambient = self.ambient(params).mT
            log = self.ambient_log_slopes(params)
            share = self.log_solid_angle.to(ambient).exp() / (4 * math.pi)
            weights = ambient * ambient.new_tensor(LUMINANCE)[:, None] * share
            mean = log.flatten(2) @ weights.flatten(1)[..., None]
            changes = log.new_empty(len(params), self.parameter_count, 3, log.shape[-1])
            of_ambient = changes[:, : self.ambient_parameters]
            torch.sub(log, mean[..., None], out=of_ambient).mul_(ambient[:, None])
            if self.count:
                of_lamps = self._lamp_slopes(params)
                if self.azimuth_index is not None:
                    changes[:, self.azimuth_index] += of_lamps[:, 0]
                changes[:, self.ambient_parameters :] = of_lamps[:, -LAMP_PARAMETERS * self.count :]
            return changes.mT

    def _lamp_slopes(self, params: Float[Tensor, "b p"]) -> Float[Tensor, "b _ 3 n"]:
        """Derivatives of the lamps' radiance along the azimuth, if there is one, and their own.

        What parameters mean is differentiated by central differences in double precision, and
        lobes in closed form by what they mean: ``dg = g (X - <g X>)`` with
        ``X = (w . dd + |w - d|^2 dlog s) / s^2``.
        """
        own = list(range(self.ambient_parameters, self.parameter_count))
        if self.azimuth_index is not None:
            own = [self.azimuth_index, *own]
        step = 1e-5 * torch.eye(self.parameter_count)[own].to(params.device).double()
        around = params.double()[:, None, None] + torch.stack([step, -step])
        lamps = self.lamps(around)
        means = torch.cat([lamps.directions, self._resolved(lamps).log()[..., None]], -1)
        energies = 4 * math.pi * lamps.energies[..., None] * lamps.colours
        by_means, by_energies = (
            ((each[:, 0] - each[:, 1]) / 2e-5).to(params) for each in (means, energies)
        )
        here = self.lamps(params)
        lobes, energy = self.lobes(here), 4 * math.pi * here.energies[..., None] * here.colours
        directions = self.directions.to(params)
        chords = squared_chords(here.directions, directions)
        towards = directions.T.expand(*chords.shape[:2], -1, -1)
        exponents = torch.cat([towards, chords[:, :, None]], 2)
        exponents = exponents / self._resolved(here)[..., None, None] ** 2
        cells = self.log_solid_angle.to(params).exp()
        exponents = exponents - exponents @ (lobes * cells)[..., None]
        along = exponents * lobes[:, :, None]
        return torch.einsum("bpkj,bkc,bkjn->bpcn", by_means, energy, along) + torch.einsum(
            "bpkc,bkn->bpcn", by_energies, lobes
        )

    def normalised(self, radiance: Float[Tensor, "*batch n 3"]) -> Float[Tensor, "*batch n 3"]:
        """Of mean luminance 1."""
        share = self.log_solid_angle.to(radiance.dtype).exp() / (4 * math.pi)
        return radiance / (luminance(radiance) @ share)[..., None, None]

    def lamps(self, params: Float[Tensor, "*batch p"]) -> Lamps:
        """What the parameters mean."""
        each = self.of_lamps(params)
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

    def of_lamps(self, params: Float[Tensor, "*batch p"]) -> Float[Tensor, "*batch k 7"]:
        """The parameters of each lamp."""
        return params[..., self.ambient_parameters :].unflatten(-1, (self.count, LAMP_PARAMETERS))

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
        exponent = -0.5 * chords / self._resolved(lamps)[..., None] ** 2
        total = torch.logsumexp(
            exponent + self.log_solid_angle.to(exponent.dtype), -1, keepdim=True
        )
        return torch.exp(exponent - total)

    def _resolved(self, lamps: Lamps) -> Float[Tensor, "*b k"]:
        """Widths: narrower than half a cell lobes would fall between the centres of two."""
        return lamps.widths_rad.clamp(min=math.pi / 2 / self.grid.layout[0])  # type: ignore[index]

    def ambient_starts(self) -> Float[Tensor, "a p"]:
        """Parameters of A to start from."""
        return self.log_solid_angle.new_zeros(1, self.ambient_parameters)

    def starts(self) -> Float[Tensor, "s p"]:
        """Lamps above, on the camera's side, all round: one start for each of A."""
        azimuth = 2 * math.pi * torch.arange(self.count, dtype=torch.float64) / max(self.count, 1)
        around = torch.stack([azimuth.sin(), torch.ones_like(azimuth), azimuth.cos()], 1)
        energies = torch.full((1, self.count), 0.3 / max(self.count, 1))
        return self.starts_at(nn.functional.normalize(around, dim=1)[None], energies)[0, ::4]

    def starts_towards(self, directions: Float[Tensor, "d 3"]) -> Float[Tensor, "d k p"]:
        """All lamps there: weak and strong ones, narrow and wide."""
        there = directions[:, None].expand(-1, self.count, -1)
        return self.starts_at(there, torch.full(there.shape[:2], 0.35 / max(self.count, 1)))

    def starts_at(
        self, directions: Float[Tensor, "s k 3"], energies: Float[Tensor, "s k"]
    ) -> Float[Tensor, "s c p"]:
        """Lamps there, of those energies (above 0) or half of them, narrow and wide.

        Four candidates for each start of A.
        """
        ambient = self.ambient_starts()
        params = ambient.new_zeros(len(directions), len(ambient), 4, self.parameter_count)
        params[..., : self.ambient_parameters] = ambient[:, None]
        each = self.of_lamps(params)
        each[..., :3] = directions.to(params)[:, None, None]
        half = torch.stack([energies, energies, energies / 2, energies / 2], 1).to(params)
        below = 1 / half.clamp(max=0.9 * MOST_ENERGY) - 1 / MOST_ENERGY
        each[..., 3] = (-(LAMP_ENERGY * below).log() / LAMP_ENERGY_SPREAD)[:, None]
        each[..., 4] = params.new_tensor([0.0, 1.3, 0.0, 1.3])[:, None]
        return params.flatten(1, 2).to(torch.get_default_dtype())
