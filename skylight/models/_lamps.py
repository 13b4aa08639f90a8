"""Lamps in smooth ambient light: a light model for rooms, studios and streets at night.

:mod:`~skylight.models._lobes` has the lamps. A is ambient light whose logarithm is a field of
spherical harmonics of degree 2.

The prior is made of what is sensible in rooms. Nothing of it is learnt from environment maps.
"""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from skylight._modes import full_precision, on_cpu, single
from skylight._module import Module
from skylight.errors import check_shape
from skylight.models._base import draws
from skylight.models._lobes import LAMP_PARAMETERS, LONGEST, LampedLight
from skylight.models._prior import convex
from skylight.sphere import _harmonics as harmonics

AMBIENT_PARAMETERS = 16
# Standard deviations over the sphere of the fields of log luminance of degree 1 and 2, and by how
# much ceilings are brighter than floors: e^(2 x 0.3) with reflectances of 0.7 and 0.2 and lamps on
# either side.
AMBIENT_SPREADS = 0.15, 0.15
UPWARD = 0.3
# Of the log of red and of blue against green: all ambient light, and its field of degree 1. A
# camera has balanced most of it.
AMBIENT_CHROMA, AMBIENT_CHROMA_FIELD = 0.2, 0.15
LAMP_HEIGHT = 1.0  # p(d) ~ e^(h d_y): lamps above are e^2 times as likely as below
_NAMES = f"{AMBIENT_PARAMETERS} of the ambient light, {LAMP_PARAMETERS} of each lamp"


class LampsLight(LampedLight):
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
    tone_scale: Tensor
    chroma_scale: Tensor

    @on_cpu
    def __init__(self, count: int, height: int = 32) -> None:
        super().__init__(AMBIENT_PARAMETERS, count, height)
        self.name = "lamps"
        basis = harmonics.evaluate(self.grid.directions, 2)
        self.register_buffer("basis", basis, persistent=False)
        self.register_buffer("tone_scale", _tone_scale(), persistent=False)
        self.register_buffer("chroma_scale", _chroma_scale(), persistent=False)

    def on_rows(self, height: int) -> "LampsLight":
        """The model on ``height`` rows."""
        return LampsLight(self.count, height).to(self.basis)

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
        return self.normalised(colours)

    def ambient_log_slopes(self, params: Float[Tensor, "b p"]) -> Float[Tensor, "b 16 3 n"]:
        """Fields times what they are scaled by."""
        basis = self.basis.to(params).T
        tone = self.tone_scale.to(params)[:, None] * basis[1:]
        chroma = self.chroma_scale.to(params)[:, None] * basis[:4]
        slopes = params.new_zeros(AMBIENT_PARAMETERS, 3, basis.shape[1])
        slopes[:8], slopes[8:12, 0], slopes[12:, 2] = tone[:, None], chroma, chroma
        inside = params[:, :AMBIENT_PARAMETERS].abs() <= LONGEST
        return slopes * inside[..., None, None]


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

    @torch.no_grad()
    def convex_shape(
        self, x: Float[Tensor, "b p"]
    ) -> tuple[Float[Tensor, "b p"], Float[Tensor, "b p p"]]:
        """Slope of ``-log_prob``, and its Hessian without negative eigenvalues, in closed form.

        Of a direction d of length r, u = d / r and the height y of u they are those of
        ``-h y + 50 (r - 1)^2 + 2 log r``: with 1 - u u^T across and u along, ::

            -h (e - y u) / r + (100 (r - 1) + 2 / r) u,
            h (e u^T + u e^T + y (1 - 3 u u^T)) / r^2 + 100 u u^T - 2 u u^T / r^2
                + (100 (r - 1) / r + 2 / r^2) (1 - u u^T).
        """
        x = single(x)
        with full_precision(x):
            slope, hessian = x.clone(), torch.eye(x.shape[1]).to(x).repeat(len(x), 1, 1)
            eye, h = torch.eye(3).to(x), LAMP_HEIGHT
            for begin in range(AMBIENT_PARAMETERS, x.shape[1], LAMP_PARAMETERS):
                at = slice(begin, begin + 3)
                r = x[:, at].norm(dim=1).clamp(min=1e-12)[:, None]
                u, up = x[:, at] / r, x[:, begin + 1, None] / r
                slope[:, at] = (100 * (r - 1) + 2 / r) * u - h * (eye[1] - up * u) / r
                r, up = r[..., None], up[..., None]
                along, rising = u[:, :, None] * u[:, None], eye[1][:, None] * u[:, None]
                bent = h * (rising + rising.mT + up * (eye - 3 * along)) / r**2
                bent = bent + (100 - 2 / r**2) * along
                hessian[:, at, at] = convex(bent + (100 * (r - 1) / r + 2 / r**2) * (eye - along))
            return slope, hessian

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
