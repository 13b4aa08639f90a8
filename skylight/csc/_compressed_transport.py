"""A transport matrix as sparse codes of its rows, and relighting without expanding them."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.csc._code import CodeTensors
from skylight.csc._greedy import Pursuit, PursuitOptions, Support, pursue
from skylight.csc._least_squares import SampledSignal
from skylight.csc._sub_dictionaries import (
    BoxDictionary,
    Part,
    degree_of,
    has_pixels,
    part_of,
    rotated_atoms,
)
from skylight.errors import InputError
from skylight.sphere._latlong_transform import LatLongTransform
from skylight.transport._matrix import TransportMatrix

FLOATS_PER_ACTIVATION = 2  # a weight, and one word for filter and place


@dataclass(frozen=True, kw_only=True)
class CompressedTransport:
    """``T[p, w] ~ dw sum_j weights_pj (R_pj d_pj)(w)``: up to s activations for each of m rows.

    ``codes`` of all rows, of one colour, in the filters of ``parts``. As ``dw`` is that of the
    grid's pixels, a row times a light is ::

        sum_w T[p, w] l(w) = sum_j weights_pj <R_pj d_pj, W l>

    and all these products are among those of one correlation of the light with the dictionary, as
    every row takes its atoms from the same filters and rotations.
    """

    parts: Sequence[Part]
    transform: LatLongTransform
    codes: CodeTensors
    address: Int[Tensor, "m s"]
    """The index of each activation's product among all those of a correlation."""

    @staticmethod
    def of(
        supports: Sequence[Support], parts: Sequence[Part], transform: LatLongTransform
    ) -> "CompressedTransport":
        """The codes of all rows, each of one colour."""
        width = max(len(support) for support in supports)
        rows = [support.tensors(parts, width) for support in supports]
        codes = CodeTensors(*(torch.stack(column) for column in zip(*rows, strict=True)))
        return CompressedTransport(
            parts=parts, transform=transform, codes=codes, address=_addresses(parts, codes)
        )

    def __len__(self) -> int:
        return len(self.codes.filters)

    @property
    def floats(self) -> int:
        """Numbers kept: a weight and a word for each activation."""
        return FLOATS_PER_ACTIVATION * int(torch.count_nonzero(self.codes.weights))

    def relight(self, radiance: Float[Tensor, "n c"]) -> Float[Tensor, "m c"]:
        """Shading ``T l``: one correlation for each colour, then s products a row."""
        grid = self.transform.grid
        if len(radiance) != len(grid):
            raise ValueError(f"light has {len(radiance)} directions, the transport {len(grid)}")
        assert grid.layout is not None
        light = _signal(radiance.double().reshape(*grid.layout, -1), self.parts, self.transform)
        return torch.stack([self._shading(c) for c in light.target.unbind(1)], 1)

    def _shading(self, light: Float[Tensor, " k"]) -> Float[Tensor, " m"]:
        products = torch.cat(
            [
                values.flatten()
                for part in (part.plan() for part in self.parts)
                for values in part.correlation.by_group(light[part.coordinates])
            ]
        )
        return (self.codes.weights[..., 0] * products[self.address]).sum(1)

    def expand(self) -> TransportMatrix:
        """The dense matrix, to compare with."""
        rows = torch.stack([self._row(CodeTensors(*one)) for one in zip(*self.codes, strict=True)])
        size = (self.transform.degree + 1) ** 2
        values = self.transform.synthesise(rows[:, :size]).flatten(1)
        if has_pixels(self.parts):
            values = values + rows[:, size:]
        matrix = values * self.transform.grid.solid_angles
        return TransportMatrix(matrix=matrix.float(), grid=self.transform.grid)

    @torch.no_grad()
    def _row(self, code: CodeTensors) -> Float[Tensor, " k"]:
        """Coordinates of one row: harmonics and, where there are any, pixels."""
        weights = code.weights[:, 0]
        coordinates = [weights @ rotated_atoms(self.parts, code)]
        for part in self.parts:
            if isinstance(part, BoxDictionary):
                mine = code.used & (code.filters >= part.first)  # it is the last part
                coordinates.append(weights[mine] @ part(code.filters[mine], code.rotations[mine]))
        return torch.cat(coordinates)


def compress(
    transport: TransportMatrix,
    parts: Sequence[Part],
    activations: int,
    *,
    options: PursuitOptions | None = None,
) -> CompressedTransport:
    """The rows of T, over a full lat-long grid, in at most ``activations`` atoms each.

    A row is ``V(w) <n, w>+ / pi``: T without its solid angles. Its error is weighted by them.
    ``parts`` are a coder's for as many rows as the grid has; fewer positions are faster.
    """
    if activations < 1:
        raise InputError(f"{activations} activations hold nothing: ask for 1 or more")
    signals = row_signals(transport)
    transform = transform_for(parts, signals.shape[1])
    codes = []
    for signal in signals:
        codes += row_codes(signal, parts, transform, [activations], options)
    return CompressedTransport.of(codes, parts, transform)


def row_signals(transport: TransportMatrix) -> Float[Tensor, "m h w"]:
    """``V(w) <n, w>+ / pi``, float64: rows of T divided by the solid angles."""
    layout = transport.grid.layout
    if layout is None or layout[1] != 2 * layout[0]:
        raise InputError(
            f"rows over {layout} are no lat-long maps: use DirectionGrid.latlong(rows)"
        )
    return (transport.matrix.double() / transport.grid.solid_angles).reshape(-1, *layout)


def transform_for(parts: Sequence[Part], height: int) -> LatLongTransform:
    """The transform of maps of ``height`` rows up to the parts' highest degree."""
    return LatLongTransform(degree_of(parts), height)


def row_codes(
    signal: Float[Tensor, "h w"],
    parts: Sequence[Part],
    transform: LatLongTransform,
    counts: list[int],
    options: PursuitOptions | None = None,
) -> list[Support]:
    """One row's codes of several sizes, ascending, from one pursuit; one colour."""
    target = _signal(signal[..., None], parts, transform)
    if float(target.energy.sum()) == 0:  # a point that no light reaches
        none = torch.zeros(0, dtype=torch.long)
        empty = Support(
            filters=none,
            places=none.reshape(0, 3),
            weights=torch.zeros(0, 1, dtype=torch.float64),
            error=0.0,
        )
        return [empty] * len(counts)
    return list(pursue(Pursuit(parts, target, options or PursuitOptions()), counts))


def _signal(
    maps: Float[Tensor, "h w c"], parts: Sequence[Part], transform: LatLongTransform
) -> SampledSignal:
    return SampledSignal.of(maps, transform, pixels=has_pixels(parts))


def _addresses(parts: Sequence[Part], codes: CodeTensors) -> Int[Tensor, "m s"]:
    """Index of each filter and rotation among the concatenated results of ``by_group``."""
    filters, rotations = codes.filters.flatten(), codes.rotations.flatten(0, 1)
    number = torch.tensor([part_of(parts, f) for f in filters.tolist()])
    out, total = torch.zeros_like(filters), 0
    for n, plan in enumerate(part.plan() for part in parts):
        starts = []
        length = plan.coordinates.stop - plan.coordinates.start
        for values in plan.correlation.by_group(torch.zeros(length, dtype=torch.float64)):
            starts.append((total, values.shape))
            total += values.numel()
        mine = torch.nonzero(number == n)[:, 0]
        places = plan.positions.places(rotations[mine])
        for i, (row, column, twist) in zip(mine.tolist(), places.tolist(), strict=True):
            group, place = plan.correlation.index[int(filters[i]) - plan.first]
            start, (twists, members, rows, columns) = starts[group]
            at = ((twist % twists * members + place) * rows + row) * columns + column
            out[i] = start + at
    return out.view_as(codes.filters)
