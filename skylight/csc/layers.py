"""A dictionary made ready: each filter bank with the rotations at which it may stand."""

import math
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from skylight.csc.correlation import RotationCorrelation
from skylight.csc.dictionary import FilterBank, finer_anisotropic, finer_isotropic
from skylight.csc.points import PixelCorrelation
from skylight.csc.positions import Positions
from skylight.csc.rotated import rotated_filters
from skylight.csc.zonal import ZonalCorrelation
from skylight.sphere import harmonics
from skylight.sphere.frame import direction_from_angles


@runtime_checkable
class Correlation(Protocol):
    """What a pursuit asks of a bank of filters at a set of rotations."""

    positions: Positions
    index: dict[int, tuple[int, int]]
    """Filter -> its group, and its place there."""

    def members(self, group: int) -> tuple[int, ...]: ...

    def by_group(
        self, residual: Float[Tensor, " k"]
    ) -> list[Float[Tensor, "_ _ rows columns"]]: ...

    def rotated(
        self, filters: Int[Tensor, " s"], places: Int[Tensor, "s 3"]
    ) -> Float[Tensor, "s k"]: ...


class Layer(nn.Module):
    """Filters ``first``, ``first`` + 1, ... of a dictionary, their degree and their rotations."""

    def __init__(
        self,
        bank: FilterBank,
        positions: Positions,
        first: int = 0,
        *,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        self.bank, self.first, self.count = bank, first, len(bank)
        self.coordinates = slice(0, bank.coefficients.shape[1])
        l = torch.arange(bank.degree + 1)  # noqa: E741
        zonal = bank.coefficients[:, l * (l + 1)].square().sum(1)
        self.isotropic = bool((zonal > 1 - 1e-12).all())
        self._positions, self._dtype = positions, dtype
        self._correlation: RotationCorrelation | ZonalCorrelation | None = None
        self.constant = frozenset(first + int(i) for i in torch.nonzero(bank.constant)[:, 0])

    @property
    def correlation(self) -> Correlation:
        """Made when it is first asked for: decoding needs none."""
        if self._correlation is None:
            zonal = self.isotropic and self._positions.twists == 1
            kind = ZonalCorrelation if zonal else RotationCorrelation
            made = kind(self.bank.coefficients.cpu(), self._positions, dtype=self._dtype)
            self._correlation = made.to(self.bank.coefficients.device)
        return self._correlation

    def turned(
        self,
        filters: Int[Tensor, " s"],
        alpha: Float[Tensor, " s"],
        beta: Float[Tensor, " s"],
        gamma: Float[Tensor, " s"],
    ) -> Float[Tensor, "s k"]:
        """Coefficients of the dictionary's filters ``filters`` after any rotations."""
        chosen = self.bank.coefficients[filters - self.first]
        if not self.isotropic:
            return rotated_filters(chosen, alpha, beta, gamma)
        bands = harmonics.zonal_factors(chosen)
        directions = direction_from_angles(math.pi - alpha, beta)
        basis = harmonics.evaluate_about_zenith(directions, self.bank.degree)
        return basis * bands[:, harmonics.bands(self.bank.degree).to(chosen.device)]


class PixelLayer(nn.Module):
    """One filter: a pixel. Its coordinates come after those of degree ``degree``."""

    constant: frozenset[int] = frozenset()
    count = 1

    def __init__(self, rows: int, first: int, degree: int) -> None:
        super().__init__()
        self.first = first
        self.coordinates = slice((degree + 1) ** 2, (degree + 1) ** 2 + 2 * rows**2)
        self.correlation: Correlation = PixelCorrelation(rows)


AnyLayer = Layer | PixelLayer


def layer_of(layers: Sequence[AnyLayer], filter_: int) -> int:
    """The number of the layer that a filter of the whole dictionary is in."""
    return max(n for n, layer in enumerate(layers) if layer.first <= filter_)


def layers_for(
    dictionary: FilterBank, height: int, *, dtype: torch.dtype = torch.float32
) -> list[AnyLayer]:
    """The dictionary at 32 x 64 positions of 32 twists, and sharper filters for finer maps.

    Lobes of degree 40 are no sharper than 2.8 degrees (standard deviation), which is 2 pixels of
    128 rows: lamps and the sun are smaller. So maps of 64 and more rows get, above the dictionary
    itself: from 128 rows on nine anisotropic Gaussians of degree 60 at 64 x 128 positions;
    isotropic ones, as sharp as pixels can show, at every pixel, which needs no rotations and so a
    few numbers each; and the pixel itself. ``iso`` stays isotropic, ``vmf`` the
    single lobe it is known for.
    """
    layers: list[AnyLayer] = [Layer(dictionary, Positions(), dtype=dtype)]
    if dictionary.name == "vmf" or height < 64:
        return layers
    first = len(dictionary)
    if height >= 128 and dictionary.name != "iso":
        bank = finer_anisotropic()
        layers.append(Layer(bank, Positions(rows=64), first, dtype=dtype))
        first += len(bank)
    rows = min(height, 128)
    bank = finer_isotropic(rows)
    layers.append(Layer(bank, Positions(rows=rows, twists=1), first, dtype=dtype))
    layers.append(PixelLayer(height, first + len(bank), degree_of(layers)))
    return layers


def has_pixels(layers: Sequence[AnyLayer]) -> bool:
    """Whether coordinates include the map's own pixels."""
    return any(isinstance(layer, PixelLayer) for layer in layers)


def degree_of(layers: Sequence[AnyLayer]) -> int:
    """The last band of any layer."""
    return max(layer.bank.degree for layer in layers if isinstance(layer, Layer))
