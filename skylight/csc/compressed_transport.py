"""A transport matrix as sparse codes of its rows, and relighting without expanding them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight.csc.layers import AnyLayer, degree_of, has_pixels, layer_of
from skylight.csc.objective import SampledSignal
from skylight.csc.pursuit import Pursuit, PursuitOptions, Support
from skylight.csc.search import pursue
from skylight.errors import InputError
from skylight.sphere.latlong_transform import LatLongTransform
from skylight.transport.matrix import TransportMatrix

FLOATS_PER_ACTIVATION = 2  # a weight, and one word for filter and place


@dataclass(frozen=True, kw_only=True)
class CompressedTransport:
    """``T[p, w] ~ dw sum_j weights_pj (R_pj d_pj)(w)``: up to s activations for each of m rows.

    ``filters`` (m,s), ``places`` (m,s,3) and ``weights`` (m,s) of ``layers``; rows with fewer
    activations are filled up with weights of 0. As ``dw`` is that of the grid's pixels, a row times
    a light is ::

        sum_w T[p, w] l(w) = sum_j weights_pj <R_pj d_pj, W l>

    and all these products are among those of one correlation of the light with the dictionary, as
    every row takes its atoms from the same filters and rotations.
    """

    layers: Sequence[AnyLayer]
    transform: LatLongTransform
    filters: Int[Tensor, "m s"]
    places: Int[Tensor, "m s 3"]
    weights: Float[Tensor, "m s"]
    address: Int[Tensor, "m s"]
    """Where the product of each activation lies among all that a correlation answers."""

    @staticmethod
    def of(
        codes: Sequence[Support], layers: Sequence[AnyLayer], transform: LatLongTransform
    ) -> "CompressedTransport":
        """The codes of all rows, each of one colour."""
        width = max(len(code) for code in codes)
        filters = torch.full((len(codes), width), layers[0].first)
        places = torch.zeros(len(codes), width, 3, dtype=torch.long)
        weights = torch.zeros(len(codes), width, dtype=torch.float64)
        for row, code in enumerate(codes):
            filters[row, : len(code)] = code.filters
            places[row, : len(code)] = code.places
            weights[row, : len(code)] = code.weights[:, 0]
        return CompressedTransport(
            layers=layers,
            transform=transform,
            filters=filters,
            places=places,
            weights=weights,
            address=_addresses(layers, filters.flatten(), places.flatten(0, 1)).view_as(filters),
        )

    def __len__(self) -> int:
        return len(self.filters)

    @property
    def floats(self) -> int:
        """Numbers kept: a weight and a word for each activation."""
        return FLOATS_PER_ACTIVATION * int(torch.count_nonzero(self.weights))

    def relight(self, radiance: Float[Tensor, "n c"]) -> Float[Tensor, "m c"]:
        """Shading ``T l``: one correlation for each colour, then s products a row."""
        grid = self.transform.grid
        if len(radiance) != len(grid):
            raise ValueError(f"light has {len(radiance)} directions, the transport {len(grid)}")
        assert grid.layout is not None
        light = _signal(radiance.double().reshape(*grid.layout, -1), self.layers, self.transform)
        return torch.stack([self._shading(c) for c in light.target.unbind(1)], 1)

    def _shading(self, light: Float[Tensor, " k"]) -> Float[Tensor, " m"]:
        products = torch.cat(
            [
                values.flatten()
                for layer in self.layers
                for values in layer.correlation.by_group(light[layer.coordinates])
            ]
        )
        return (self.weights * products[self.address]).sum(1)

    def expand(self) -> TransportMatrix:
        """The dense matrix, to compare with."""
        rows = torch.zeros(len(self), _end(self.layers), dtype=torch.float64)
        numbers = torch.tensor([layer_of(self.layers, f) for f in self.filters.flatten().tolist()])
        numbers = numbers.view_as(self.filters)
        for number, layer in enumerate(self.layers):
            for p in torch.nonzero((numbers == number).any(1))[:, 0].tolist():
                mine = numbers[p] == number
                atoms = layer.correlation.rotated(
                    self.filters[p][mine] - layer.first, self.places[p][mine]
                )
                rows[p, layer.coordinates] += self.weights[p][mine] @ atoms.double()
        size = (self.transform.degree + 1) ** 2
        values = self.transform.synthesise(rows[:, :size]).flatten(1)
        if has_pixels(self.layers):
            values = values + rows[:, size:]
        matrix = values * self.transform.grid.solid_angles
        return TransportMatrix(matrix=matrix.float(), grid=self.transform.grid)


def compress(
    transport: TransportMatrix,
    layers: Sequence[AnyLayer],
    activations: int,
    *,
    options: PursuitOptions | None = None,
    progress: Callable[[float], None] | None = None,
) -> CompressedTransport:
    """The rows of T, as functions on the sphere, in at most ``activations`` atoms each.

    A row is ``V(w) <n, w>+ / pi``: T without its solid angles. Its error is weighted by them.

    Parameters
    ----------
    transport : over a full lat-long grid.
    layers : as a coder's for as many rows as the grid has; fewer positions are faster.

    Raises
    ------
    InputError
        Another grid, or no activations.
    """
    signals = row_signals(transport)
    if activations < 1:
        raise InputError(f"{activations} activations hold nothing: ask for 1 or more")
    transform = transform_for(layers, signals.shape[1])
    codes = []
    for p, signal in enumerate(signals, 1):
        codes += row_codes(signal, layers, transform, [activations], options)
        if progress is not None:
            progress(p / len(signals))
    return CompressedTransport.of(codes, layers, transform)


def row_signals(transport: TransportMatrix) -> Float[Tensor, "m h w"]:
    """``V(w) <n, w>+ / pi``, float64: rows of T divided by the solid angles."""
    layout = transport.grid.layout
    if layout is None or layout[1] != 2 * layout[0]:
        raise InputError(
            f"rows over {layout} are no lat-long maps: use DirectionGrid.latlong(rows)"
        )
    return (transport.matrix.double() / transport.grid.solid_angles).reshape(-1, *layout)


def transform_for(layers: Sequence[AnyLayer], height: int) -> LatLongTransform:
    """The transform of maps of ``height`` rows up to the layers' highest degree."""
    return LatLongTransform(degree_of(layers), height)


def row_codes(
    signal: Float[Tensor, "h w"],
    layers: Sequence[AnyLayer],
    transform: LatLongTransform,
    counts: list[int],
    options: PursuitOptions | None = None,
) -> list[Support]:
    """One row's codes of several sizes, ascending, from one pursuit; one colour."""
    target = _signal(signal[..., None], layers, transform)
    if float(target.energy.sum()) == 0:  # a point that no light reaches
        none = torch.zeros(0, dtype=torch.long)
        empty = Support(
            filters=none,
            places=none.reshape(0, 3),
            weights=torch.zeros(0, 1, dtype=torch.float64),
            error=0.0,
        )
        return [empty] * len(counts)
    return list(pursue(Pursuit(layers, target, options or PursuitOptions()), counts))


def _signal(
    maps: Float[Tensor, "h w c"], layers: Sequence[AnyLayer], transform: LatLongTransform
) -> SampledSignal:
    return SampledSignal.of(maps, transform, pixels=has_pixels(layers))


def _length(layer: AnyLayer) -> int:
    return layer.coordinates.stop - layer.coordinates.start


def _end(layers: Sequence[AnyLayer]) -> int:
    """The number of coordinates of all layers."""
    return max(layer.coordinates.stop for layer in layers)


def _addresses(
    layers: Sequence[AnyLayer], filters: Int[Tensor, " a"], places: Int[Tensor, "a 3"]
) -> Int[Tensor, " a"]:
    """Index of (filter, place) among the concatenated answers of ``by_group``."""
    starts: list[list[tuple[int, torch.Size]]] = []
    total = 0
    for layer in layers:
        answers = layer.correlation.by_group(torch.zeros(_length(layer), dtype=torch.float64))
        starts.append([])
        for values in answers:
            starts[-1].append((total, values.shape))
            total += values.numel()
    out = []
    for filter_, (row, column, twist) in zip(filters.tolist(), places.tolist(), strict=True):
        number = layer_of(layers, filter_)
        group, place = layers[number].correlation.index[filter_ - layers[number].first]
        start, (twists, members, rows, columns) = starts[number][group]
        at = ((twist % twists * members + place) * rows + row) * columns + column
        out.append(start + at)
    return torch.tensor(out, dtype=torch.long)
