"""The probe as an encoder of light: Eq. 4.3 to 4.25."""

import math

import pytest
import torch
from torch import Tensor, nn
from torch.autograd import gradcheck
from torch.func import functional_call

from skylight.errors import InputError
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions._probe import PartitionProbe
from skylight.probes.partitions._seeds import ProbeDesign
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid

GRID = DirectionGrid.latlong(32)
RGB = torch.tensor([0.9, 0.6, 0.3]).double()


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def probe_of(name: str, albedo: float | Tensor = 0.8, **options: Tensor) -> PartitionProbe:
    return PartitionProbe(Cells.of(named_design(name)), albedo, **options)


@pytest.mark.parametrize("name", ["6d", "14d-outdoor", "110d"])
def test_uniform_light_gives_the_exact_form_factor(name: str) -> None:
    probe = probe_of(name, RGB)
    cells = probe.cells
    gathered = cells.clamped_cosine(cells.normals).diagonal()
    expected = RGB / math.pi * gathered[:, None] * 2.5
    radiance = torch.full((1, len(GRID), 3), 2.5).double()
    torch.testing.assert_close(probe(radiance, GRID)[0], expected, rtol=1e-12, atol=0)


@pytest.mark.parametrize("name", ["6d", "14d-sun-6"])
def test_decoded_shading_encodes_to_itself(name: str) -> None:
    probe = probe_of(name, RGB)
    shading = random(2, probe.cells.count, 3)
    again = probe(probe.decode(shading, GRID), GRID)
    torch.testing.assert_close(again, shading, rtol=1e-12, atol=0)


def test_light_of_the_cells_comes_back() -> None:
    """Eq. 4.4 to 4.6 on radiance that is constant in each cell."""
    probe = probe_of("14d")
    light = random(1, 14, 3)
    shading = probe(light[:, probe.cells.cell_of(GRID.directions)], GRID)
    torch.testing.assert_close(probe.light(shading), light, rtol=1e-12, atol=0)
    torch.testing.assert_close(shading * probe.weights, light, rtol=1e-12, atol=0)


def test_a_lamp_gives_its_cosine_to_its_own_face_alone() -> None:
    probe = probe_of("6d", 0.5)
    grid = DirectionGrid.latlong(256)
    lamp = int((grid.directions @ torch.tensor([0.6, 0.7, 0.2]).double()).argmax())
    radiance = torch.zeros(1, len(grid), 3).double()
    radiance[0, lamp] = 100.0
    shading = probe(radiance, grid)[0, :, 0]
    direction, angle = grid.directions[lamp], grid.solid_angles[lamp]
    face = int(probe.cells.cell_of(direction[None]))
    expected = 0.5 / math.pi * float(probe.cells.normals[face] @ direction * angle) * 100
    assert float(shading[face]) == pytest.approx(expected, rel=1e-3)
    assert float(shading.sum() - shading[face]) == 0


def test_a_uniform_map_gives_the_exact_form_factor() -> None:
    probe = probe_of("14d-outdoor", RGB)
    found = probe.encode_map(EnvironmentMap(radiance=torch.full((32, 64, 3), 2.5)))
    expected = RGB / math.pi * probe.facing[:, None] * 2.5
    torch.testing.assert_close(found, expected.float(), rtol=1e-6, atol=0)


def test_maps_are_shared_between_cells_within_their_pixels() -> None:
    """One linear map, two resolutions: coarse pixels lie across borders."""
    probe = probe_of("14d")
    coarse = EnvironmentMap(radiance=random(16, 32, 3).float())
    fine = coarse.radiance.repeat_interleave(48, 0).repeat_interleave(48, 1).reshape(1, -1, 3)
    expected = probe(fine, DirectionGrid.latlong(768))[0]
    torch.testing.assert_close(probe.encode_map(coarse), expected, rtol=0.01, atol=0)
    nearest = probe(coarse.flat[None], coarse.grid)[0]
    assert float((nearest - expected).abs().max()) > 3 * float(
        (probe.encode_map(coarse) - expected).abs().max()
    )


@pytest.mark.parametrize("name", ["14d", "14d-outdoor"])
def test_basis_and_dual_basis_are_bi_orthogonal(name: str) -> None:
    probe = probe_of(name, RGB)
    basis, dual = probe.basis(GRID), probe.dual_basis(GRID)
    for colour in range(3):
        product = (basis[..., colour] * GRID.solid_angles) @ dual[..., colour].T
        identity = torch.eye(probe.cells.count).double()
        torch.testing.assert_close(product, identity, rtol=0, atol=1e-12)


def test_projecting_on_the_basis_is_encoding() -> None:
    """Eq. 4.20: coefficients are the shading."""
    probe, radiance = probe_of("14d", RGB), random(1, len(GRID), 3)
    coefficients = torch.einsum("ndk,dk,d->nk", probe.basis(GRID), radiance[0], GRID.solid_angles)
    torch.testing.assert_close(coefficients, probe(radiance, GRID)[0])


@pytest.mark.parametrize(("name", "tolerance"), [("14d", 0.005), ("110d", 0.05)])
def test_the_basis_is_the_cosine_in_each_cell(name: str, tolerance: float) -> None:
    """Eq. 4.18, but for how finely the grid covers the cells."""
    probe, grid = probe_of(name, RGB), DirectionGrid.latlong(128)
    cell = probe.cells.cell_of(grid.directions)
    cosine = (probe.cells.normals[cell] * grid.directions).sum(1)
    expected = RGB / math.pi * cosine[:, None]
    values = probe.basis(grid)[cell, torch.arange(len(grid))]
    torch.testing.assert_close(values, expected, rtol=tolerance, atol=0)


def test_faces_without_walls_gather_more_by_a_known_factor() -> None:
    """Eq. 4.23 to 4.25: under uniform light s'' is s; a bare face shows rho L."""
    probe = probe_of("14d-outdoor", 0.7)
    radiance = torch.full((1, len(GRID), 3), 3.0).double()
    bare = probe.unpartitioned(radiance, GRID)
    torch.testing.assert_close(bare, torch.full_like(bare, 2.1), rtol=1e-12, atol=0)
    corrected = bare * probe.correction[:, None]
    torch.testing.assert_close(corrected, probe(radiance, GRID), rtol=1e-12, atol=0)


def test_bare_faces_show_irradiance() -> None:
    probe, environment = probe_of("6d", 1.0), EnvironmentMap(radiance=random(32, 64, 3))
    bare = probe.unpartitioned(environment.flat[None], environment.grid)[0]
    expected = torch.stack([environment.irradiance(n) for n in probe.cells.normals]) / math.pi
    torch.testing.assert_close(bare, expected, rtol=2e-3, atol=0)


def test_measured_walls_are_undone() -> None:
    cells = Cells.of(named_design("14d"))
    response = torch.diag(0.8 * cells.facing) + 0.02 * cells.neighbours
    probe = PartitionProbe(cells, torch.linspace(0.5, 0.9, 14).double()[:, None], response=response)
    light = random(1, 14, 3)
    shading = probe(light[:, cells.cell_of(GRID.directions)], GRID)
    torch.testing.assert_close(probe.light(shading), light, rtol=1e-10, atol=0)
    expected = torch.linspace(0.5, 0.9, 14).double()[:, None] / math.pi * (response @ light[0])
    torch.testing.assert_close(shading[0], expected, rtol=1e-10, atol=0)
    # the ideal weights would be wrong by what the walls do
    assert float(((shading * probe.weights - light) / light).abs().median()) > 0.05


def test_encoding_and_decoding_have_gradients() -> None:
    probe, grid = probe_of("6d"), DirectionGrid.latlong(4)
    radiance, albedo = random(1, len(grid), 3).requires_grad_(), probe.albedo

    def told(radiance: Tensor, albedo: Tensor) -> Tensor:
        module = _Told(probe, grid)
        return functional_call(module, {"probe.albedo": albedo}, (radiance,))

    assert gradcheck(told, (radiance, albedo))


class _Told(nn.Module):
    def __init__(self, probe: PartitionProbe, grid: DirectionGrid) -> None:
        super().__init__()
        self.probe, self.grid = probe, grid

    def forward(self, radiance: Tensor) -> Tensor:
        return self.probe.decode(self.probe(radiance, self.grid) ** 2, self.grid)


def test_lights_of_any_leading_shape_are_each_by_itself() -> None:
    probe, radiance = probe_of("14d", RGB), random(2, 3, len(GRID), 3)
    shading = probe(radiance, GRID)
    whole = probe.decode(shading, GRID), probe.unpartitioned(radiance, GRID)
    for i, j in [(0, 1), (1, 2)]:
        torch.testing.assert_close(shading[i, j], probe(radiance[i, j], GRID))
        torch.testing.assert_close(whole[0][i, j], probe.decode(shading[i, j], GRID))
        torch.testing.assert_close(whole[1][i, j], probe.unpartitioned(radiance[i, j], GRID))


def test_what_follows_from_the_albedo_follows_its_changes() -> None:
    """After an optimiser's step, and after loading it, as in a fresh probe."""
    probe, light = probe_of("14d"), random(len(GRID), 3)
    probe(light, GRID)
    (slope,) = torch.autograd.grad(probe(light, GRID).sum(), probe.albedo)
    with torch.no_grad():
        probe.albedo.sub_(0.05 * slope.sign())
    assert float(probe.albedo.max()) < 0.76
    fresh, loaded = probe_of("14d", probe.albedo.detach()), probe_of("14d", 0.3)
    loaded.load_state_dict(probe.state_dict())
    assert set(probe.state_dict()) == {"albedo"}
    for same in (probe, loaded):
        torch.testing.assert_close(same(light, GRID), fresh(light, GRID))
        torch.testing.assert_close(same.weights, fresh.weights)
        shading = random(14, 3)
        torch.testing.assert_close(same.decode(shading, GRID), fresh.decode(shading, GRID))


def test_a_measured_response_is_part_of_the_state() -> None:
    cells = Cells.of(named_design("14d"))
    responses = [torch.diag(share * cells.facing) + 0.02 * cells.neighbours for share in (0.8, 0.9)]
    first, second = (PartitionProbe(cells, response=response) for response in responses)
    shading = random(14, 3)
    second.load_state_dict(first.state_dict())
    torch.testing.assert_close(second.light(shading), first.light(shading), rtol=0, atol=0)
    with pytest.raises(RuntimeError, match="response"):
        PartitionProbe(cells).load_state_dict(first.state_dict())


def test_precision_and_device_are_those_of_the_light(device: torch.device) -> None:
    radiance = random(2, len(GRID), 3)
    expected = probe_of("6d", RGB)(radiance, GRID).to(device)
    probe = probe_of("6d", RGB).to(device)
    shading = probe(radiance.float().to(device), GRID)
    assert shading.dtype == probe.decode(shading, GRID).dtype == torch.float32
    torch.testing.assert_close(shading, expected.float())
    torch.testing.assert_close(
        probe.float()(radiance.to(device), GRID), expected, rtol=1e-5, atol=0
    )
    torch.testing.assert_close(probe.double().decode(probe(radiance.to(device), GRID), GRID),
                               probe.decode(expected, GRID), rtol=1e-5, atol=0)  # fmt: skip


def test_what_cannot_be_encoded_is_refused() -> None:
    probe = probe_of("110d")
    with pytest.raises(InputError, match="finer grid"):
        probe(random(1, 32, 3), DirectionGrid.latlong(4))
    with pytest.raises(InputError, match="only a part"):
        probe(random(1, 64, 3), DirectionGrid.sky(4))
    with pytest.raises(InputError, match="ground first"):
        probe.encode_map(EnvironmentMap(radiance=random(8, 32, 3)))


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"albedo": 0.0}, "above 0"),
        ({"albedo": 1.2}, "at most 1"),
        ({"albedo": torch.full((6,), 0.5)}, "6 faces"),
        ({"response": torch.eye(5)}, "measure it"),
        ({"response": torch.ones(6, 6)}, "inverted"),
        ({"response": torch.full((6, 6), torch.nan)}, "inverted"),
    ],
)
def test_impossible_probes_are_refused(options: dict, reason: str) -> None:
    cells = Cells.of(ProbeDesign.of("cube", named_design("6d").seeds))
    with pytest.raises(InputError, match=reason):
        PartitionProbe(cells, **options)
