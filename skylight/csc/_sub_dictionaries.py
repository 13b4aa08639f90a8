"""Multiresolution dictionaries: sub-dictionaries of growing sharpness, each with its rotations.

The sharpest are boxes of a map's own pixels, which have no band limit: for the edges of lamps,
windows and walls.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import pad

from skylight._modes import on_cpu
from skylight._module import Module
from skylight.csc._code import CodeTensors
from skylight.csc._dictionary import FilterBank, finer_anisotropic, finer_isotropic
from skylight.csc._positions import Chunk, Positions, by_signal
from skylight.csc._wigner import (
    FilterRotation,
    RotationCorrelation,
    ZonalCorrelation,
    is_zonal,
)
from skylight.errors import InputError, check_shape
from skylight.sphere._frame import DirectionGrid

Sizes = tuple[tuple[int, int], ...]  # (rows, columns) of boxes


@runtime_checkable
class Correlation(Protocol):
    """Correlations of a signal with the filters of a sub-dictionary at a set of rotations."""

    positions: Positions
    index: dict[int, tuple[int, int]]
    """Filter -> its group, and its index there."""

    def members(self, group: int) -> tuple[int, ...]: ...

    def by_group(
        self, residual: Float[Tensor, "*batch k"]
    ) -> list[Float[Tensor, "*batch _ _ rows columns"]]: ...

    def in_chunks(self, residuals: Float[Tensor, "s k"]) -> Iterator[Chunk]: ...

    def rotated(
        self, filters: Int[Tensor, " s"], places: Int[Tensor, "s 3"]
    ) -> Float[Tensor, "s k"]: ...


@dataclass(frozen=True, kw_only=True)
class SearchPlan:
    """What a pursuit needs of a sub-dictionary, for the filters as they are now.

    Filters ``first`` .. ``first + count - 1`` of the whole dictionary, whose coefficients are
    ``coordinates`` of a signal's; those in ``constant`` are the same at every rotation.
    """

    filters: Float[Tensor, "m k"]
    positions: Positions
    first: int
    coordinates: slice
    constant: frozenset[int]
    dtype: torch.dtype

    @property
    def count(self) -> int:
        return len(self.filters)

    @cached_property
    def correlation(self) -> Correlation:
        """Made when it is first asked for: decoding needs none."""
        zonal = self.positions.twists == 1 and is_zonal(self.filters)
        kind = ZonalCorrelation if zonal else RotationCorrelation
        return kind(self.filters, self.positions, dtype=self.dtype)


class SubDictionary(Module):
    """A bank of filters, ``first``, ``first + 1``, ... of a dictionary, and their rotations.

    ``dtype`` is that of the search; it follows ``.double()`` and ``.float()``.
    """

    search: Tensor

    def __init__(
        self,
        bank: FilterBank,
        positions: Positions,
        first: int = 0,
        *,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        self.bank, self.positions, self.first = bank, positions, first
        # only what no optimiser changes stays isotropic
        zonal = not list(bank.parameters()) and is_zonal(bank.coefficients)
        self.rotation = FilterRotation(bank.degree, zonal=zonal)
        self.register_buffer("search", torch.empty(0, dtype=dtype), persistent=False)
        self._plan: SearchPlan | None = None

    @property
    def count(self) -> int:
        return len(self.bank)

    @property
    def constant(self) -> frozenset[int]:
        """The filters that are the constant function."""
        return frozenset(self.first + int(i) for i in torch.nonzero(self.bank.constant)[:, 0])

    def plan(self) -> SearchPlan:
        """The correlations of the filters as they are now; made anew when those have changed.

        They are compared by value, so no change in place goes unseen.
        """
        now, old = self.bank.coefficients.detach(), self._plan
        if (
            old is None
            or old.dtype != self.search.dtype
            or (old.filters.dtype, old.filters.device) != (now.dtype, now.device)
            or not torch.equal(old.filters, now)
        ):
            self._plan = SearchPlan(
                filters=now,
                positions=self.positions,
                first=self.first,
                coordinates=slice(0, now.shape[1]),
                constant=self.constant,
                dtype=self.search.dtype,
            )
        assert self._plan is not None
        return self._plan

    def forward(
        self, filters: Int[Tensor, " s"], rotations: Float[Tensor, "s 3"]
    ) -> Float[Tensor, "s k"]:
        """The atoms: coefficients of ``filters`` after rotations by Euler angles, differentiable.

        In what they depend on, filters and angles.
        """
        return self.rotation(self.bank.coefficients[filters - self.first], rotations)


class BoxCorrelation(Module):
    """``<p, r>`` for boxes p of a lat-long map's pixels, of unit norm: 1 / sqrt(solid angle).

    Filter i covers ``sizes[i]`` (rows, columns) of a map of ``rows``; 1 x 1 is the pixel, the
    sharpest filter there is. The place of a box is its middle pixel, of two the upper or left one.
    It may cross the seam, but no pole: places at which it would correlate with nothing.

    Answers like :class:`~skylight.csc._wigner.ZonalCorrelation`. Its residual is that of
    pixels, ``dw (x - y)``, which follows the spherical harmonics' in what
    :class:`~skylight.csc._least_squares.SampledSignal` calls coordinates.
    """

    radiance: Tensor
    extent: Tensor

    @on_cpu
    def __init__(self, rows: int, sizes: Sizes) -> None:
        super().__init__()
        self.positions, self.sizes = Positions(rows=rows, twists=1), sizes
        self.index = {i: (0, i) for i in range(len(sizes))}
        largest = tuple(max(size) for size in zip(*sizes, strict=True))
        if largest[0] > rows or largest[1] > 2 * rows:
            raise InputError(
                f"boxes of {largest[0]} rows and {largest[1]} columns do not fit a map of "
                f"{rows}x{2 * rows}: use a finer map or another dictionary"
            )
        extent = torch.tensor(sizes)
        solid_angles = DirectionGrid.latlong(rows).solid_angles.view(rows, 2 * rows)
        top = torch.arange(rows) - (extent[:, :1] - 1) // 2
        inside = (top >= 0) & (top + extent[:, :1] <= rows)
        radiance = self._sums(solid_angles)[..., 0].rsqrt() * inside
        self.register_buffer("radiance", radiance, persistent=False)  # (filter, row)
        self.register_buffer("extent", extent, persistent=False)

    def _sums(self, values: Float[Tensor, "*batch rows columns"]) -> Float[Tensor, "*batch f _ _"]:
        """Sums over the boxes about every place, rows and then columns, 0 beyond the poles."""
        tall = {
            rows: pad(values, (0, 0, (rows - 1) // 2, rows // 2)).unfold(-2, rows, 1).sum(-1)
            for rows in {rows for rows, _ in self.sizes}
        }
        out = []
        for rows, columns in self.sizes:
            left, right = -((columns - 1) // 2), values.shape[-1] + columns // 2
            column = torch.arange(left, right, device=values.device)
            round_ = tall[rows][..., column % values.shape[-1]]
            out.append(round_.unfold(-1, columns, 1).sum(-1))
        return torch.stack(out, -3)

    def members(self, group: int) -> tuple[int, ...]:
        return tuple(range(len(self.sizes)))

    def by_group(
        self, residual: Float[Tensor, "*batch n"]
    ) -> list[Float[Tensor, "*batch _ _ rows columns"]]:
        """One group, one twist."""
        p = self.positions
        check_shape("residuals", residual.shape, p.rows * p.columns)
        sums = self._sums(residual.reshape(*residual.shape[:-1], p.rows, p.columns))
        return [(sums * self.radiance.to(residual.dtype)[..., None])[..., None, :, :, :]]

    def in_chunks(self, residuals: Float[Tensor, "s n"]) -> Iterator[Chunk]:
        """What :meth:`by_group` gives, a part at a time."""
        return by_signal(residuals, lambda some: self.by_group(some)[0])

    def spans(self, filters: Int[Tensor, " s"], places: Int[Tensor, "s 3"]) -> Int[Tensor, "s 4"]:
        """First row, rows, first column and columns of boxes; a first column may lie left of 0."""
        extent = self.extent[filters]
        first = places[:, :2].to(extent.device) - (extent - 1) // 2
        return torch.stack([first[:, 0], extent[:, 0], first[:, 1], extent[:, 1]], 1)

    def rotated(
        self, filters: Int[Tensor, " s"], places: Int[Tensor, "s 3"]
    ) -> Float[Tensor, "s n"]:
        """The boxes at these places, as maps."""
        down, across = self.sides(filters, places)
        return (down[:, :, None] * across[:, None]).flatten(1)

    def sides(
        self, filters: Int[Tensor, " s"], places: Int[Tensor, "s 3"]
    ) -> tuple[Float[Tensor, "s rows"], Float[Tensor, "s columns"]]:
        """What the boxes are products of: their radiance in their rows, 1 in their columns."""
        device, p = self.radiance.device, self.positions
        filters, places = filters.to(device), places.to(device)
        top, rows, left, columns = self.spans(filters, places)[:, :, None].unbind(1)
        row = torch.arange(p.rows, device=device) - top
        column = (torch.arange(p.columns, device=device) - left).remainder(p.columns)
        down = ((row >= 0) & (row < rows)) * self.radiance[filters, places[:, 0]][:, None]
        return down, (column < columns).to(down)


class BoxDictionary(Module):
    """Boxes of pixels; the pixel alone unless ``sizes`` says otherwise.

    Coordinates are the pixels' values, which come after the harmonics' of degree ``degree``.
    """

    constant: frozenset[int] = frozenset()

    def __init__(self, rows: int, first: int, degree: int, *, sizes: Sizes = ((1, 1),)) -> None:
        super().__init__()
        self.first, self.count = first, len(sizes)
        self.coordinates = slice((degree + 1) ** 2, (degree + 1) ** 2 + 2 * rows**2)
        self.boxes = BoxCorrelation(rows, sizes)
        self.positions = self.boxes.positions

    @property
    def correlation(self) -> Correlation:
        return self.boxes

    def plan(self) -> "BoxDictionary":
        return self

    def spans(
        self, filters: Int[Tensor, " s"], rotations: Float[Tensor, "s 3"]
    ) -> Int[Tensor, "s 4"]:
        """First row, rows, first column and columns of the activations' boxes."""
        return self.boxes.spans(filters - self.first, self.positions.places(rotations))

    def forward(
        self, filters: Int[Tensor, " s"], rotations: Float[Tensor, "s 3"]
    ) -> Float[Tensor, "s n"]:
        """The atoms, as maps: ``filters`` about the pixels nearest to the rotations' centres."""
        return self.boxes.rotated(filters - self.first, self.positions.places(rotations))

    def sides(
        self, codes: CodeTensors
    ) -> tuple[Float[Tensor, "*batch s rows"], Float[Tensor, "*batch s columns"]]:
        """What each activation's box is the product of; 0 for other filters and for padding."""
        mine, filters, rotations = own(self, codes)
        down, across = self.boxes.sides(filters, self.positions.places(rotations))
        down = torch.where(mine[:, None], down, 0)
        shape, p = codes.filters.shape, self.positions
        return down.view(*shape, p.rows), across.view(*shape, p.columns)


# Rows by columns, of a dictionary "box". Files of codes number them in this order: never change it.
BOX_SIZES = tuple((rows, columns) for rows in (1, 2, 3, 4, 6, 8) for columns in (1, 2, 3, 4, 6, 8))
Part = SubDictionary | BoxDictionary
Plan = SearchPlan | BoxDictionary


def part_of(parts: Sequence[Part | Plan], filter_: int) -> int:
    """The number of the sub-dictionary that a filter of the whole dictionary belongs to."""
    return max(n for n, part in enumerate(parts) if part.first <= filter_)


def multiresolution(
    dictionary: FilterBank, height: int, *, dtype: torch.dtype = torch.float32
) -> list[Part]:
    """The dictionary at 32 x 64 positions of 32 twists, and sharper filters for finer maps.

    Lobes of degree 40 are no sharper than 2.8 degrees (standard deviation), which is 2 pixels of
    128 rows: lamps and the sun are smaller. So maps of 64 and more rows get, besides the dictionary
    itself: from 128 rows on nine anisotropic Gaussians of degree 60 at 64 x 128 positions;
    isotropic ones, as sharp as pixels can show, at every pixel, which needs no rotations and so a
    few numbers each; and the pixel itself. ``iso`` stays isotropic, ``vmf`` the
    single lobe it is known for. ``box`` has boxes of pixels in the pixel's place, at any height.
    """
    parts: list[Part] = [SubDictionary(dictionary, Positions(), dtype=dtype)]
    first, boxes = len(dictionary), dictionary.name == "box"
    sizes = BOX_SIZES if boxes else ((1, 1),)
    if height < 64 and boxes:
        parts.append(BoxDictionary(height, first, dictionary.degree, sizes=sizes))
    if dictionary.name == "vmf" or height < 64:
        return parts
    if height >= 128 and dictionary.name != "iso":
        bank = finer_anisotropic()
        parts.append(SubDictionary(bank, Positions(rows=64), first, dtype=dtype))
        first += len(bank)
    rows = min(height, 128)
    bank = finer_isotropic(rows)
    parts.append(SubDictionary(bank, Positions(rows=rows, twists=1), first, dtype=dtype))
    parts.append(BoxDictionary(height, first + len(bank), degree_of(parts), sizes=sizes))
    return parts


def rotated_atoms(parts: Sequence[Part], codes: CodeTensors) -> Float[Tensor, "*batch s k"]:
    """Coefficients of each activation's rotated filter; zeros for boxes and for padding.

    Differentiable in the dictionary's filters and in the rotations.
    """
    size, found = (degree_of(parts) + 1) ** 2, []
    for part in parts:
        if isinstance(part, SubDictionary):
            mine, filters, rotations = own(part, codes)
            atoms = torch.where(mine[:, None], part(part.first + filters, rotations), 0)
            found.append(pad(atoms, (0, size - atoms.shape[1])))
    return sum(found[1:], found[0]).view(*codes.filters.shape, size)


def own(
    part: Part, codes: CodeTensors
) -> tuple[Bool[Tensor, " s"], Int[Tensor, " s"], Float[Tensor, "s 3"]]:
    """Which activations of a batch are of this sub-dictionary, and all activations as if they were.

    Their filters counted from its first, and their rotations, 0 for others. Those are masked, not
    left out: how many there are would decide what is computed, which no compiler can follow.
    """
    filters = codes.filters.flatten() - part.first
    mine = (filters >= 0) & (filters < part.count) & codes.used.flatten()
    rotations = torch.where(mine[:, None], codes.rotations.flatten(0, -2), 0)
    return mine, filters.clamp(0, part.count - 1), rotations


def has_pixels(parts: Sequence[Part | Plan]) -> bool:
    """Whether coordinates include the map's own pixels."""
    return any(isinstance(part, BoxDictionary) for part in parts)


def degree_of(parts: Sequence[Part]) -> int:
    """The last band of any sub-dictionary."""
    return max(part.bank.degree for part in parts if isinstance(part, SubDictionary))
