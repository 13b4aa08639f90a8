"""The decoder of a dictionary's sparse codes as an ONNX graph, for programs without torch."""

import copy
import math
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from skylight.csc._code import CodeTensors
from skylight.csc._coder import SphericalSparseCoder
from skylight.csc._sub_dictionaries import BoxDictionary
from skylight.errors import InputError, SkylightError
from skylight.io._atomic import atomic_path
from skylight.io._onnx import onnx_graph
from skylight.maps._sparse_codes import DECODED_ROWS
from skylight.sphere._latlong_transform import LatLongTransform

INPUTS = ("filters", "rotations", "weights")
_CODES, _ACTIVATIONS = 3, 16  # of the comparison, in each sub-dictionary
_UNIT = 2.0**-24  # the rounding of float32


def export_codes(
    coder: SphericalSparseCoder, path: str | Path, *, rows: int | None = None
) -> float:
    """Write ``coder.decode`` as an ONNX graph of float32: a dictionary, deployed.

    Its inputs are those of :class:`~skylight.csc.CodeTensors`, of any number of codes b and
    activations s, its output the ``map``:

    ``filters`` (b, s)
        int64, from 0; other numbers are no filter.
    ``rotations`` (b, s, 3)
        rad: longitude of the centre (from +Z towards +X), its angle from the zenith, twist.
    ``weights`` (b, s, 3)
        The colours; 0 where a code has fewer activations.
    ``map`` (b, rows, 2 rows, 3)
        Radiance, row 0 at the zenith, -Z in the centre; negative where the weights make it so.

    The file says so too, with the dictionary's name, fingerprint and number of filters, and
    ``height``, the rows of the maps that were coded; ``rows`` are the same by default.

    Before anything is written, onnxruntime decodes random codes. Returned is the largest
    difference from torch in float64, by the code's norm: ``|onnx - torch| / sum_j |w_j|``.

    Raises
    ------
    InputError
        So many rows are not written.
    SkylightError
        Its maps are further from torch's than float32 explains (:func:`bound`).
    """
    rows = coder.height if rows is None else rows
    low, high = DECODED_ROWS
    if not low <= rows <= high:
        raise InputError(f"maps of {rows} rows: ask for {low} to {high}")
    exact = copy.deepcopy(coder).cpu().double()
    found = _random_codes(exact)
    graph = _graph(exact, rows, found)
    with torch.no_grad():
        expected = exact.decode(found, rows)
    error = np.abs(decoded_by(graph, found) - expected.numpy()).max((1, 2, 3))
    difference = float((error / found.weights.abs().sum((1, 2)).numpy()).max())
    if not difference <= (most := bound(exact)):  # NaN is none either
        raise SkylightError(
            f"{path} was not written: onnxruntime's maps differ from torch's by {difference:.2g}, "
            f"more than {most:.2g}; try other versions of torch, onnxscript and onnxruntime"
        )
    with atomic_path(path) as temporary:
        temporary.write_bytes(graph)
    return difference


def bound(coder: SphericalSparseCoder) -> float:
    """What float32 may cost a map's value, by the sum of the weights' magnitudes.

    Of degree K and s activations, with the unit u of rounding. Coefficients of a filter of unit
    norm are turned by three angles m phi, |phi| < 8, m <= K, each wrong by 8 K u in phi and as much
    in the product, so by 16 K u; sums of 2 (K + 1) products twice, of s once, and of the filter's
    own norm are wrong by as many u, and a map's value is the product of a coefficient vector with
    one of norm (K + 1) / sqrt(4 pi), summed over 3 (K + 1) products. A box is a product of three
    numbers, and a sum over s.
    """
    size, activations = coder.degree + 1, _ACTIVATIONS * len(coder.parts)
    steps = 3 * 16 * size + 4 * size + activations + 3 * size + 4
    most = size / math.sqrt(4 * math.pi)
    boxes = [part.boxes.radiance.max() for part in coder.parts if isinstance(part, BoxDictionary)]
    return _UNIT * (steps * most + sum(float(each) * (activations + 3) for each in boxes))


def decoded_by(graph: bytes, codes: CodeTensors) -> np.ndarray:
    """The maps that onnxruntime makes of codes."""
    import onnxruntime

    session = onnxruntime.InferenceSession(graph, providers=["CPUExecutionProvider"])
    given = (codes.filters, codes.rotations.float(), codes.weights.float())
    (maps,) = session.run(
        ["map"], {name: each.numpy() for name, each in zip(INPUTS, given, strict=True)}
    )
    return np.asarray(maps)


def _random_codes(coder: SphericalSparseCoder) -> CodeTensors:
    """Of every sub-dictionary, at places of its own; numbers that float32 holds."""
    generator, filters, rotations = torch.Generator().manual_seed(0), [], []
    shape = _CODES, _ACTIVATIONS
    for part in coder.parts:
        p = part.positions
        some = [torch.randint(n, shape, generator=generator) for n in (p.rows, p.columns, p.twists)]
        filters.append(part.first + torch.randint(part.count, shape, generator=generator))
        rotations.append(p.rotations(torch.stack(some, -1).flatten(0, 1)).unflatten(0, shape))
    together = torch.cat(filters, 1)
    weights = torch.randn(*together.shape, 3, generator=generator).double()
    count = torch.full((_CODES,), together.shape[1])
    return CodeTensors(together, torch.cat(rotations, 1).float().double(), weights, count)


def _graph(coder: SphericalSparseCoder, rows: int, codes: CodeTensors) -> bytes:
    given = (codes.filters, codes.rotations.float(), codes.weights.float())
    return onnx_graph(
        _Decoder(coder, rows).float(),
        dict(zip(INPUTS, given, strict=True)),
        "map",
        sizes={name: {0: "codes", 1: "activations"} for name in INPUTS},
        metadata={
            "dictionary": coder.bank.name,
            "fingerprint": coder.bank.fingerprint,
            "filter_count": str(coder.count),
            "height": str(coder.height),
            "banded": str(coder.banded).lower(),
            "rows": str(rows),
            "activations": str(coder.activations),
            "filters": "(codes, activations): numbers from 0; others are no filter",
            "rotations": "(codes, activations, 3), radians: longitude of the filter's centre, from "
            "+Z towards +X with +Y up, its angle from the zenith, twist about it",
            "weights": "(codes, activations, 3): linear Rec.709; 0 for activations that are none",
            "map": "(codes, rows, 2 rows, 3): lat-long radiance, row 0 at the zenith, centre "
            "along -Z; may be negative",
        },
    )


class _Decoder(nn.Module):
    """``decode`` at some rows as ``forward``, which is what exporters follow."""

    def __init__(self, coder: SphericalSparseCoder, rows: int) -> None:
        super().__init__()
        self.coder = copy.deepcopy(coder)
        self.transform = LatLongTransform(coder.degree, rows)

    def forward(self, filters: Tensor, rotations: Tensor, weights: Tensor) -> Tensor:
        count = torch.full_like(filters[:, 0], filters.shape[1])
        return self.coder.decode_on(self.transform, CodeTensors(filters, rotations, weights, count))
