"""Rows of a transport matrix as sparse codes."""

import math

import pytest
import torch

from skylight.csc._compressed_transport import (
    CompressedTransport,
    compress,
    row_signals,
    transform_for,
)
from skylight.csc._dictionary import FilterBank, isotropic
from skylight.csc._greedy import Support
from skylight.csc._positions import Positions
from skylight.csc._sub_dictionaries import BoxDictionary, Part, SubDictionary
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._frame import DirectionGrid
from skylight.transport._matrix import TransportMatrix

POSITIONS = Positions(rows=8, twists=8)


def unshadowed(height: int = 16) -> TransportMatrix:
    """<n, w>+ dw / pi of a few normals, and of a point that sees no light."""
    normals = torch.tensor([[0.0, 1, 0], [0.6, 0.8, 0], [0, -0.6, 0.8], [0, 0, 0]]).double()
    grid = DirectionGrid.latlong(height)
    cosine = (normals @ grid.directions.T).clamp(min=0)
    matrix = (cosine * grid.solid_angles / math.pi).float()
    return TransportMatrix(matrix=matrix, grid=grid)


def parts_of_three_kinds() -> list[Part]:
    """Filters without any symmetry, isotropic ones above them, and boxes."""
    bands = 1 + harmonics.bands(6)
    skewed = torch.randn(3, 49, generator=torch.Generator().manual_seed(0)).double() / bands**2
    wide = FilterBank(torch.cat([skewed, -skewed]), "skewed")
    narrow = isotropic(8, 5)
    return [
        SubDictionary(wide, POSITIONS),
        SubDictionary(narrow, Positions(rows=16, twists=1), len(wide)),
        BoxDictionary(16, len(wide) + len(narrow), 8, sizes=((1, 1), (3, 2))),
    ]


@pytest.fixture(scope="module")
def compressed() -> CompressedTransport:
    return compress(unshadowed(), parts_of_three_kinds(), 6)


def test_relighting_is_the_expanded_matrix_times_the_light(compressed: CompressedTransport):
    light = torch.rand(16 * 32, 3, generator=torch.Generator().manual_seed(0))
    expanded = compressed.expand().matrix @ light
    shading = compressed.relight(light)
    assert float((shading - expanded).abs().max()) < 1e-5 * float(expanded.max())


def test_every_layer_is_read_where_its_atoms_stand():
    parts, transform = parts_of_three_kinds(), transform_for(parts_of_three_kinds(), 16)
    code = Support(
        filters=torch.tensor([0, 0, 4, 7, parts[2].first, parts[2].first + 1]),
        places=torch.tensor([[2, 5, 3], [2, 5, 7], [7, 15, 0], [9, 31, 0], [4, 30, 0], [5, 0, 0]]),
        weights=torch.tensor([[1.0], [-0.5], [2], [0.7], [0.1], [0.3]]).double(),
        error=0.0,
    )
    compressed = CompressedTransport.of([code], parts, transform)
    light = torch.rand(16 * 32, 1, generator=torch.Generator().manual_seed(1)).double()
    expanded = compressed.expand().matrix.double() @ light
    assert float(compressed.relight(light)) == pytest.approx(float(expanded), rel=1e-5)


def test_rows_are_met(compressed: CompressedTransport):
    true, found = row_signals(unshadowed()), row_signals(compressed.expand())
    share = compressed.transform.solid_angles
    error = ((true - found).square() * share).sum((1, 2))
    energy = (true.square() * share).sum((1, 2))
    assert bool((error[:3] < 0.15**2 * energy[:3]).all())
    assert float(error[3]) == 0


def test_every_activation_is_counted(compressed: CompressedTransport):
    assert compressed.floats == 2 * int(torch.count_nonzero(compressed.codes.weights)) <= 2 * 3 * 6
