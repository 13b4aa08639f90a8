import pytest
import torch
import trimesh
from torch import nn
from torch.autograd import gradcheck
from torch.func import functional_call

from skylight.errors import InputError
from skylight.probes._encoder import ObjectEncoder, SurfaceTransfer, choose_points
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions._probe import PartitionProbe
from skylight.probes.partitions.relight._composite import Relighting
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid
from tests.probes.objects import GRID, lights, ring_and_ball, solid, transfer_of


@pytest.fixture(scope="module")
def points() -> SurfaceTransfer:
    candidates = transfer_of(ring_and_ball(), 300)
    return candidates.at(choose_points(candidates, 14))


def test_the_dual_is_biorthogonal(points):
    encoder = ObjectEncoder(points)
    products = torch.einsum("ckd,cld,d->ckl", encoder.basis, encoder.dual, GRID.solid_angles)
    torch.testing.assert_close(
        products, torch.eye(14).double().expand(3, 14, 14), atol=1e-6, rtol=0
    )


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_the_dual_solves_the_normal_equations(points, noise):
    encoder = ObjectEncoder(points, noise=noise)
    ridge = noise**2 * encoder.gram.diagonal(dim1=1, dim2=2).mean(1)
    torch.testing.assert_close(encoder.ridge, ridge)
    system = encoder.gram + ridge[:, None, None] * torch.eye(14)
    torch.testing.assert_close(encoder.dual, torch.linalg.solve(system, encoder.basis))


def test_decoded_light_explains_the_shading_and_is_the_least(points):
    encoder = ObjectEncoder(points).requires_grad_(False)
    light = lights(3)
    shading = encoder(light)
    decoded = encoder.decode(shading)
    torch.testing.assert_close(encoder(decoded), shading)
    # what light differs by from the least is orthogonal to the least
    rest = ((light - decoded) * decoded * GRID.solid_angles[:, None]).sum((1, 2))
    power = (decoded.square() * GRID.solid_angles[:, None]).sum((1, 2))
    assert float((rest / power).abs().max()) < 1e-10
    # and lights of the span come back
    torch.testing.assert_close(encoder.decode(encoder(decoded)), decoded)


def test_points_light_other_bodies_by_one_product(points):
    body = transfer_of(solid(trimesh.creation.icosphere(2)), 50, seed=1)
    encoder = ObjectEncoder(points, noise=0.01)
    shading = encoder(lights(2))
    relit = Relighting(encoder.transfer(body))(shading)
    expected = body.shading(encoder.decode(shading))
    torch.testing.assert_close(relit.double(), expected, atol=1e-5, rtol=1e-5)


def test_points_of_the_basis_relight_themselves(points):
    transfer = ObjectEncoder(points).transfer(points)
    one = torch.eye(14)[..., None].expand(-1, -1, 3)
    torch.testing.assert_close(transfer.values, one, atol=1e-5, rtol=0)
    white = points.shading(torch.ones(1, len(GRID), 3)).mean()
    assert float(transfer.orders.sum()) == pytest.approx(float(white), rel=1e-5)


def test_a_partition_probe_is_the_special_case_of_a_diagonal_gram():
    probe = PartitionProbe(Cells.of(named_design("14d")), 0.7)
    grid = DirectionGrid.latlong(32)
    probe = probe.requires_grad_(False)
    points = SurfaceTransfer(functions=probe.basis(grid), grid=grid)
    encoder = ObjectEncoder(points).requires_grad_(False)
    off = encoder.gram - torch.diag_embed(encoder.gram.diagonal(dim1=1, dim2=2))
    assert float(off.abs().max()) < 1e-12
    torch.testing.assert_close(encoder.dual.permute(1, 2, 0), probe.dual_basis(grid))
    light = torch.rand(2, len(grid), 3, dtype=torch.float64)
    torch.testing.assert_close(encoder(light), probe(light, grid))


@pytest.mark.parametrize("wrong", [0.2, 5.0])
def test_the_ridge_of_the_noise_recovers_white_light_best(points, wrong):
    noise = 0.1
    generator = torch.Generator().manual_seed(2)
    # white noise on the sphere: variance 1 / dw
    light = torch.randn(500, len(GRID), 3, generator=generator, dtype=torch.float64)
    light /= GRID.solid_angles.sqrt()[:, None]
    shading = points.shading(light)
    level = noise * shading.square().mean((0, 1)).sqrt()
    noisy = shading + level * torch.randn(shading.shape, generator=generator, dtype=torch.float64)

    def error(assumed: float) -> float:
        decoded = ObjectEncoder(points, noise=assumed).decode(noisy)
        return float(((decoded - light).square() * GRID.solid_angles[:, None]).sum())

    assert error(noise) < error(wrong * noise)


def test_maps_are_averaged_to_the_grid(points):
    encoder = ObjectEncoder(points)
    fine = EnvironmentMap(radiance=torch.rand(32, 64, 3))
    torch.testing.assert_close(encoder.encode_map(fine), encoder(fine.resize(16).flat))
    with pytest.raises(InputError, match="whole sphere"):
        encoder.encode_map(EnvironmentMap(radiance=torch.rand(8, 32, 3)))


def test_light_and_basis_have_gradients():
    grid = DirectionGrid.latlong(3)
    generator = torch.Generator().manual_seed(0)
    functions = torch.rand(2, len(grid), 3, generator=generator, dtype=torch.float64)
    encoder = ObjectEncoder(SurfaceTransfer(functions=functions, grid=grid), noise=0.1)
    light = torch.rand(len(grid), 3, generator=generator, dtype=torch.float64, requires_grad=True)

    def told(light, basis):
        shading = functional_call(encoder, {"basis": basis}, (light,))
        return shading, functional_call(Decoding(encoder), {"encoder.basis": basis}, (shading,))

    assert gradcheck(told, (light, encoder.basis))


class Decoding(nn.Module):
    """``forward`` of an encoder is its shading; here it is its light."""

    def __init__(self, encoder: ObjectEncoder) -> None:
        super().__init__()
        self.encoder = encoder

    def forward(self, shading):
        return self.encoder.decode(shading)


def test_lights_of_any_leading_shape_are_each_by_itself(points):
    encoder = ObjectEncoder(points)
    light = lights(6).reshape(2, 3, len(GRID), 3)
    shading, decoded = encoder(light), encoder.decode(encoder(light))
    for i, j in [(0, 0), (1, 2)]:
        torch.testing.assert_close(shading[i, j], encoder(light[i, j]))
        torch.testing.assert_close(decoded[i, j], encoder.decode(shading[i, j]))


def test_what_follows_from_the_basis_follows_its_changes(points):
    """After an optimiser's step, and after loading it, as in a fresh encoder."""
    encoder, light = ObjectEncoder(points, noise=0.02), lights(1)
    optimiser = torch.optim.Adam(encoder.parameters(), lr=1e-3)
    (encoder.decode(encoder(light)) - light).square().mean().backward()
    optimiser.step()
    changed = SurfaceTransfer(functions=encoder.basis.detach().permute(1, 2, 0), grid=GRID)
    fresh = ObjectEncoder(changed, noise=0.02)
    loaded = ObjectEncoder(points, noise=0.02)
    assert not torch.allclose(loaded.dual, fresh.dual)
    loaded.load_state_dict(encoder.state_dict())
    assert set(encoder.state_dict()) == {"basis"}
    for same in (encoder, loaded):
        torch.testing.assert_close(same(light), fresh(light))
        torch.testing.assert_close(same.decode(fresh(light)), fresh.decode(fresh(light)))


def test_precision_and_device_are_those_of_the_light(points, device):
    light = lights(2)
    encoder = ObjectEncoder(points, noise=0.02).to(device)
    expected = ObjectEncoder(points, noise=0.02)(light).to(device)
    shading = encoder(light.float().to(device))
    assert shading.dtype == encoder.decode(shading).dtype == torch.float32
    torch.testing.assert_close(shading, expected.float())
    torch.testing.assert_close(encoder.float()(light.to(device)), expected, rtol=1e-5, atol=1e-5)


def test_refusals(points):
    twice = points.at(torch.tensor([0, 1, 1]))
    with pytest.raises(InputError, match="same as others"):
        ObjectEncoder(twice)
    assert bool(ObjectEncoder(twice, noise=0.01).dual.isfinite().all())
    with pytest.raises(InputError, match="0 or more"):
        ObjectEncoder(points, noise=-0.1)
    dark = SurfaceTransfer(functions=torch.zeros(2, len(GRID), 3), grid=GRID)
    with pytest.raises(InputError, match="no light"):
        ObjectEncoder(dark, noise=0.1)
    other = DirectionGrid.latlong(8)
    coarse = SurfaceTransfer(functions=torch.ones(2, len(other), 3), grid=other)
    with pytest.raises(InputError, match="one and the same grid"):
        ObjectEncoder(points).transfer(coarse)
