"""A surface whose normals may be wrong: what scan and objective make of it."""

from dataclasses import replace

import pytest
import torch
from torch.nn.functional import normalize

from skylight.inverse import _scan as scan
from skylight.inverse._faces import FaceTerm, ObjectiveWeights
from skylight.inverse._objective import LightObjective
from skylight.inverse._scan import SCAN_HEIGHT, SunScan, scan_faces
from skylight.transport._matrix import TransportMatrix
from skylight.transport._normal_modes import NormalModes
from skylight.transport._observation import Observation
from tests.inverse.test_objective import MODEL, normal, observation, parameters
from tests.inverse.test_pigments import pigments, varied
from tests.inverse.test_scan import GRID, SUNS, degrees_between, under

K = 3


@pytest.fixture(scope="module")
def bumps():
    """(normals, modes): a ball's visible half, and smooth ways in which its normals are wrong."""
    rows = torch.linspace(-0.95, 0.95, 26)
    y, x = (each.flatten() for each in torch.meshgrid(rows, rows, indexing="ij"))
    inside = x**2 + y**2 < 0.9
    x, y = x[inside], y[inside]
    normals = torch.stack([x, y, (1 - x**2 - y**2).sqrt()], 1)
    fields = torch.stack(
        [
            torch.stack([x * 0 + 1, y * 0, y * 0], 1),  # the whole face turns
            torch.stack([x.sign() * (3 * y).cos(), y * 0, x * 0], 1),
            torch.stack([x * y, (4 * x).sin(), x * 0], 1),
        ],
        2,
    )
    fields = fields - normals[:, :, None] * (normals[:, :, None] * fields).sum(1, keepdim=True)
    return normals, 0.12 * fields


def transport_of(normals):
    """That of a ball, which hides nothing from itself."""
    cosine = (normals.double() @ GRID.directions.T).clamp(min=0)
    matrix = (cosine * GRID.solid_angles / torch.pi).float()
    return TransportMatrix(matrix=matrix, grid=GRID)


def mistaken(bumps, sun, amounts):
    """A ball whose normals are wrong by ``amounts`` of its modes, in the light of a sun."""
    normals, modes = bumps
    light, direction = under(sun, share=0.7)
    truth = transport_of(normalize(normals + modes @ torch.tensor(amounts), dim=1))
    fitted = transport_of(normals)
    places = (normals[:, [1, 0]] * 13 + 13).long()
    return (
        Observation(
            pixels=0.5 * truth.matrix @ light,
            weights=torch.linspace(0.5, 1, len(normals)),
            places=places,
            transport=fitted,
            normal_modes=NormalModes.of(fitted, normals, modes, SCAN_HEIGHT),
        ),
        direction,
    )


@pytest.mark.parametrize("sun", SUNS[:3])
@pytest.mark.parametrize("amounts", [(0.0, 1.5, -1.0), (0.0, -1.0, 1.2)])
def test_wrong_normals_turn_the_sun_less_where_they_may_be_wrong(bumps, sun, amounts):
    seen, direction = mistaken(bumps, sun, amounts)
    told, trusted = (
        SunScan.of(scan_faces([one])) for one in (seen, replace(seen, normal_modes=None))
    )
    assert float(told.residuals.min()) < 0.5 * float(trusted.residuals.min())
    off = [degrees_between(each.candidates[0], direction) for each in (told, trusted)]
    assert off[0] < 7
    assert off[0] <= off[1] + 1e-6


def test_a_head_that_may_be_turned_leaves_more_directions_open(bumps):
    seen, _ = mistaken(bumps, SUNS[0], (0.0, 0.0, 0.0))
    told, trusted = (scan_faces([one])[0] for one in (seen, replace(seen, normal_modes=None)))
    assert bool((told.unexplained <= trusted.unexplained + 1e-4).all())
    open_to = [int((one.unexplained < 0.003).sum()) for one in (told, trusted)]
    assert open_to[0] > 1.3 * open_to[1]


def test_the_likeliest_directions_may_be_scanned_alone(bumps):
    seen, _ = mistaken(bumps, SUNS[0], (0.4, 1.0, -0.5))
    before = scan_faces([seen])
    other = replace(seen, weights=seen.weights.flip(0))
    few, every = (scan_faces([other], before=before, likeliest=n)[0] for n in (40, None))
    order = before[0].unexplained.argsort()
    mine, rest = order[:40], order[40:]
    for name in ("unexplained", "strengths", "solution"):
        found, whole, old = (getattr(one, name) for one in (few, every, before[0]))
        torch.testing.assert_close(found[mine], whole[mine], rtol=1e-4, atol=1e-6)
        assert torch.equal(found[rest], old[rest])
    assert int(every.unexplained.argmin()) in mine
    torch.testing.assert_close(few.deviations, every.deviations, rtol=1e-4, atol=1e-6)
    assert few.without_sun == pytest.approx(every.without_sun, rel=1e-4)


@pytest.mark.slow
def test_what_is_left_is_that_of_all_unknowns_together(bumps, monkeypatch):
    # Of one sun and no ambient light, the last round's problem is one of least squares in (a, a u).
    monkeypatch.setattr(scan, "NORMAL_ROUNDS", 8)
    seen, direction = mistaken(bumps, SUNS[0], (0.4, 1.0, -0.5))
    found = scan_faces([seen])[0]
    coarse = seen.on_rows(SCAN_HEIGHT)
    cell = int((coarse.transport.grid.directions[: len(found.unexplained)] @ direction).argmax())
    weights = seen.weights.double()
    y = seen.pixels.double() @ torch.tensor([0.2126, 0.7152, 0.0722]).double()
    ways = torch.einsum(
        "mck,c->mk", seen.normal_modes.modes.double(), coarse.transport.grid.directions[cell]
    )
    ways = ways * seen.normal_modes.visible[:, cell, None].double()
    lobes = scan._ambient_lobes(coarse.transport.grid)
    ambient = coarse.transport.matrix.double() @ lobes
    axes = coarse.transport.grid.directions
    vectors = torch.stack(
        [(seen.normal_modes.visible.double() * axis) @ lobes for axis in axes.T], 2
    )
    level = (weights @ y) ** 2 / weights.sum()
    free = torch.zeros(1 + ambient.shape[1] + K, dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.LBFGS([free], max_iter=3000, line_search_fn="strong_wolfe",
                                  tolerance_change=1e-14)  # fmt: skip
    sun_scale = float(y.mean() / coarse.transport.matrix[:, cell].mean())
    ambient_scale = float(y.mean() / ambient.mean())

    def cost():
        sun = sun_scale * torch.exp(free[0])
        lobe = ambient_scale * torch.exp(free[1 : 1 + ambient.shape[1]] - 4)
        u = free[-K:]
        shaded = sun * (coarse.transport.matrix[:, cell].double() + ways @ u) + ambient @ lobe
        modes = seen.normal_modes.modes.double()
        shaded = shaded + torch.einsum("mck,mjc,j,k->m", modes, vectors, lobe, u)
        return (weights * (y - shaded) ** 2).sum() + scan.NORMAL_COST * level * u.square().sum()

    def closure():
        optimiser.zero_grad()
        value = cost() / level
        value.backward()
        return value

    optimiser.step(closure)
    left = float(cost()) / float((weights * y**2).sum())
    assert float(found.unexplained[cell]) == pytest.approx(left, rel=0.03)
    assert left < 0.02


def turned():
    seen = observation()
    generator = torch.Generator().manual_seed(4)
    normals = normalize(torch.randn(len(seen.pixels), 3, generator=generator), dim=1)
    modes = 0.1 * torch.randn(len(seen.pixels), 3, K, generator=generator)
    layout = seen.transport.grid.layout
    errors = NormalModes.of(seen.transport, normals, modes, layout[0] // 2)
    return replace(seen, normal_modes=errors)


def objective(seen, normal_spread=0.5):
    weights = ObjectiveWeights(normal_spread=normal_spread)
    return LightObjective([FaceTerm.of(seen)], MODEL, normal(9), normal(3), weights)


def turns(count=5):
    return 0.5 * torch.randn(count, 1, K, generator=torch.Generator().manual_seed(8))


def test_shading_has_what_the_turned_normals_add(double):
    seen, amounts = turned(), turns()
    whole = objective(seen)
    light, exposure, specular_scale, albedo, ground, _ = parameters()
    free = whole.pack(light, exposure, specular_scale, albedo, ground, turns=amounts)
    parts = whole.unpack(free)
    torch.testing.assert_close(parts.turns, amounts)
    full = whole.ground.append(MODEL(light), ground) * exposure[:, None]
    assert seen.normal_modes is not None
    errors = seen.normal_modes
    layout = seen.transport.grid.layout
    assert layout is not None
    rows, columns = layout
    blocks = full.reshape(len(free), rows // 2, 2, columns // 2, 2, 3).mean((2, 4))
    for b in range(len(free)):
        diffuse = albedo[b] * (seen.transport.matrix @ full[b])
        radiance = blocks[b].reshape(-1, 3)
        for colour in range(3):
            vector = (errors.visible * radiance[:, colour]) @ errors.grid.directions
            added = ((errors.modes @ (0.5 * amounts[b, 0])) * vector).sum(1)
            expected = (diffuse[:, colour] + albedo[b, 0, colour] * added).clamp(min=0)
            expected = expected + specular_scale[b] * (seen.specular.matrix @ full[b])[:, colour]
            torch.testing.assert_close(whole.shading(parts)[0][b, :, colour], expected)
    nll = 0.5 * amounts.square().sum((1, 2))
    torch.testing.assert_close(whole.terms(free)["normal_prior"], nll)


def test_trusted_normals_are_those_that_were_fitted(double):
    given, seen = parameters(), turned()
    plain = objective(replace(seen, normal_modes=None))
    value = plain(plain.pack(*given))
    told, switched_off = objective(seen), objective(seen, normal_spread=0.0)
    assert torch.equal(told(told.pack(*given)), value)
    assert torch.equal(switched_off(switched_off.pack(*given)), value)
    assert told.size == plain.size + K
    assert switched_off.size == plain.size


def test_slopes_are_those_of_finite_differences(double):
    """And of pigments, which it has too."""
    seen = varied(turned())
    weights = ObjectiveWeights(normal_spread=0.5, pigment_spread=1.0)
    whole = LightObjective([FaceTerm.of(seen)], MODEL, normal(9), normal(3), weights)
    free = whole.pack(*parameters(count=1), turns=turns(1), pigments=pigments(1))
    free = free.requires_grad_(True)
    assert torch.autograd.gradcheck(whole, (free,), eps=1e-6, atol=1e-4, rtol=1e-5)


def test_the_bayes_scale_leaves_turns_alone(double):
    whole = objective(turned())
    free = whole.pack(*parameters(), turns=turns())
    torch.testing.assert_close(
        whole.unpack(whole.at_bayes_scale(free)).turns, whole.unpack(free).turns
    )


def test_coarser_modes_are_means_over_blocks(double):
    seen = turned()
    coarse = seen.coarser(1)
    for k, place in enumerate(coarse.places):
        mine = (seen.places // 2 == place).all(1).double() * seen.weights
        for here, fine in (
            (coarse.normal_modes.modes[k], seen.normal_modes.modes),
            (coarse.normal_modes.visible[k], seen.normal_modes.visible),
        ):
            torch.testing.assert_close(here, torch.einsum("m,m...->...", mine / mine.sum(), fine))
