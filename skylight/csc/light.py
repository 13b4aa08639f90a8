"""A sparse code as a light model: its places stay, its colours and its azimuth are free."""

import math
from dataclasses import replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from skylight.csc.code import SparseCode
from skylight.csc.coder import SphericalSparseCoder, coder_for
from skylight.csc.layers import PixelLayer
from skylight.errors import InputError
from skylight.sphere.envmap import luminance, shift_columns
from skylight.sphere.frame import angles_from_direction
from skylight.sphere.grid import DirectionGrid
from skylight.sphere.latlong_transform import LatLongTransform

# log stays finite: weights below this are moved here by to_free
_MIN_WEIGHT = 1e-6
_MAX_LOG_WEIGHT = 40.0
_DARK = 1e-6  # of the mean over the sphere


class SparseLight(nn.Module):
    """The light model ``R(azimuth) max(0, sum_j w_j R_j d_j)`` of a code's s activations.

    Parameters ``(b, 3 s + 1)`` are the colours ``(b, s, 3)`` flattened and the azimuth by which
    the code is turned. :meth:`starts` has the code's colours, scaled to a mean luminance of 1
    above (over the whole sphere for a code that is dark above). Colours are 0 or more where the
    code's own are all, and unbounded otherwise.

    Parameters
    ----------
    code, coder
        A code, and the coder that decodes it where its dictionary is not built in.
    height
        Rows of the lat-long grid, over the whole sphere.

    Raises
    ------
    InputError
        The code shows no light, or is none of the coder's.
    """

    atoms: Tensor
    weights: Tensor

    def __init__(
        self, code: SparseCode, coder: SphericalSparseCoder | None = None, *, height: int = 64
    ) -> None:
        super().__init__()
        self.name = f"csc{len(code)}"
        self.parameter_count = 3 * len(code) + 1
        self.azimuth_index: int | None = 3 * len(code)
        self.grid = DirectionGrid.latlong(height)
        self.nonnegative = bool((code.weights >= 0).all())
        coder = coder or coder_for(code)
        self.register_buffer("atoms", _atoms(code, coder, height), persistent=False)
        light = luminance(self._unturned(code.weights[None])[0]).double()
        solid_angles, above = self.grid.solid_angles, self.grid.directions[:, 1] > 0
        level = float(light @ (solid_angles * above)) / (2 * math.pi)
        everywhere = float(light @ solid_angles) / (4 * math.pi)
        if not everywhere > 0:
            raise InputError("the code shows no light: code a map that is not black")
        level = level if level > _DARK * everywhere else everywhere
        self.register_buffer("weights", code.weights.double() / level, persistent=False)
        brightest = self.grid.directions[light.argmax()]
        self.brightest_azimuth_rad = float(angles_from_direction(brightest)[0])

    @property
    def bounds(self) -> tuple[Float[Tensor, " p"], Float[Tensor, " p"]]:
        high = torch.full((self.parameter_count,), math.inf, dtype=torch.float64)
        low = -high
        if self.nonnegative:
            low[:-1] = 0
        return low, high

    def radiance(self, params: Float[Tensor, "b p"]) -> Float[Tensor, "b n 3"]:
        """``max(0, sum_j w_j R_j d_j)``, turned by the azimuth, exact in energy row by row."""
        assert self.grid.layout is not None
        light = self._unturned(params[:, :-1].unflatten(1, (-1, 3)))
        images = light.unflatten(1, self.grid.layout)
        return shift_columns(images, params[:, -1]).flatten(1, 2)

    def to_free(self, params: Float[Tensor, "b p"]) -> Float[Tensor, "b p"]:
        """Colours as they are or, where they have a bound, their logarithms; the azimuth as it is.

        Colours below 1e-6 move to there.
        """
        if not self.nonnegative:
            return params
        return torch.cat([params[:, :-1].clamp(min=_MIN_WEIGHT).log(), params[:, -1:]], dim=1)

    def from_free(self, free: Float[Tensor, "b p"]) -> Float[Tensor, "b p"]:
        """Inverse of :meth:`to_free`."""
        if not self.nonnegative:
            return free
        # a line search may try anything; e^40 is as wrong as infinity but finite
        return torch.cat([free[:, :-1].clamp(max=_MAX_LOG_WEIGHT).exp(), free[:, -1:]], dim=1)

    def starts(self) -> Float[Tensor, "s p"]:
        """The code as it stands."""
        return self._turned(torch.zeros(1, dtype=torch.float64))

    def starts_towards(self, directions: Float[Tensor, "d 3"]) -> Float[Tensor, "d k p"]:
        """The code with its brightest direction turned to each azimuth; its height stays."""
        azimuth, _ = angles_from_direction(directions.to(torch.float64))
        return self._turned(azimuth - self.brightest_azimuth_rad)[:, None]

    def _turned(self, azimuth_rad: Float[Tensor, " d"]) -> Float[Tensor, "d p"]:
        colours = self.weights.reshape(1, -1).expand(len(azimuth_rad), -1)
        params = torch.cat([colours, azimuth_rad[:, None].to(colours)], dim=1)
        return params.to(torch.get_default_dtype())

    def _unturned(self, weights: Float[Tensor, "b s 3"]) -> Float[Tensor, "b n 3"]:
        return (self.atoms.to(weights) @ weights).clamp(min=0)


def _atoms(code: SparseCode, coder: SphericalSparseCoder, height: int) -> Float[Tensor, "n s"]:
    """What each activation adds to a map of ``height`` rows for a weight of 1."""
    coder.check(code)
    transform = LatLongTransform(coder.degree, height)
    unit = torch.eye(len(code), dtype=torch.float64)
    smooth = transform.synthesise(coder.coefficients(code.filters, code.angles(), unit).T)
    atoms = smooth.flatten(1).T.contiguous()
    pixels = torch.nonzero(_are_pixels(code, coder))[:, 0]
    for start in range(0, len(pixels), 3):  # one to a colour
        some = pixels[start : start + 3]
        dots = coder.dots(_of(code, some), transform).flatten(0, 1)
        atoms[:, some] = dots[:, : len(some)]
    return atoms


def _are_pixels(code: SparseCode, coder: SphericalSparseCoder) -> Bool[Tensor, " s"]:
    first = [layer.first for layer in coder.layers if isinstance(layer, PixelLayer)]
    return code.filters >= (first[0] if first else coder.count)


def _of(code: SparseCode, some: Int[Tensor, " k"]) -> SparseCode:
    """Up to three activations, the first red, the second green, the third blue."""
    return replace(
        code,
        filters=code.filters[some],
        directions=code.directions[some],
        twists_rad=code.twists_rad[some],
        weights=torch.eye(3, dtype=torch.float64)[: len(some)],
    )
