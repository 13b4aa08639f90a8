"""The objective of inverse lighting: its parameters, its parts, its slope, its pyramid."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from skylight.imaging._edits import edited
from skylight.inverse._descent import best_exposure
from skylight.inverse._faces import WHITE_BALANCE_SPREAD, FaceTerm, ObjectiveWeights
from skylight.inverse._lbfgs import minimise
from skylight.inverse._objective import LightObjective
from skylight.models._prior import GaussianMixture
from skylight.models.sunsky import SunSky
from skylight.sphere._frame import DirectionGrid
from skylight.transport._matrix import TransportMatrix
from skylight.transport._observation import Observation
from skylight.transport._reflection import specular_transport
from skylight.transport._render import Specular

ROWS, SIDE = 4, 8
MODEL = SunSky(height=ROWS)
WEIGHTS = ObjectiveWeights()
EDITED = replace(WEIGHTS, contrast_spread=0.15)
UNEDITED = replace(WEIGHTS, saturation_spread=0.0, contrast_spread=0.0)


pytestmark = pytest.mark.usefixtures("double")


def normal(size):
    return GaussianMixture(torch.ones(1), torch.zeros(1, size), torch.eye(size)[None])


def observation(*, specular=True):
    """Random normals towards the camera, convex, on a square of pixels; some without weight."""
    generator = torch.Generator().manual_seed(11)
    count = SIDE * SIDE
    normals = torch.randn(count, 3, generator=generator)
    normals[:, 2] = normals[:, 2].abs()
    normals = torch.nn.functional.normalize(normals, dim=1)
    grid = DirectionGrid.latlong(2 * ROWS)
    matrix = (normals @ grid.directions.T).clamp(min=0) * grid.solid_angles / torch.pi
    transport = TransportMatrix(matrix=matrix, grid=grid)
    views = torch.tensor([0.0, 0.0, 1.0]).expand(count, 3)
    weights = torch.rand(count, generator=generator)
    weights[::7] = 0
    y, x = torch.meshgrid(torch.arange(SIDE), torch.arange(SIDE), indexing="ij")
    return Observation(
        pixels=torch.rand(count, 3, generator=generator) + 0.1,
        weights=weights,
        places=torch.stack([y.flatten() + 3, x.flatten() + 5], 1),
        transport=transport,
        specular=specular_transport(transport, normals, views, Specular()) if specular else None,
    )


def objective(seen):
    return LightObjective([FaceTerm.of(seen)], MODEL, normal(9), normal(3), WEIGHTS)


def parameters(count=5, seed=2):
    """(light, exposure, specular scale, albedo, ground albedo, white balance) of one face."""
    rng = np.random.default_rng(seed)
    parts = (
        np.concatenate(
            [
                rng.uniform(0.2, 2, (count, 6)),
                rng.uniform(-3, 3, (count, 1)),
                rng.uniform(0.1, 1.4, (count, 1)),
                rng.uniform(2, 20, (count, 1)),
                rng.uniform(10, 60, (count, 1)),
            ],
            1,
        ),
        rng.uniform(0.1, 5, (count, 1)),
        rng.uniform(0.3, 3, (count, 1)),
        rng.uniform(0.05, 0.8, (count, 1, 3)),
        rng.uniform(0.05, 0.4, (count, 3)),
        rng.normal(0, 0.1, (count, 1, 2)),
    )
    return tuple(torch.from_numpy(p) for p in parts)


def test_unpacking_undoes_packing():
    whole, given = objective(observation()), parameters()
    free = whole.pack(*given)
    assert free.shape == (5, whole.size)
    parts = whole.unpack(free)
    found = (parts.light, parts.exposure, parts.specular_scale, parts.albedo, parts.ground_albedo)
    for theirs, ours in zip((*found, parts.balance), given, strict=True):
        torch.testing.assert_close(theirs, ours)


@pytest.mark.parametrize("specular", [True, False])
def test_shading_is_transport_times_the_whole_sphere(specular):
    seen = observation(specular=specular)
    whole, (light, exposure, shine, albedo, ground, balance) = objective(seen), parameters()
    red, blue = balance[:, 0].exp().unbind(1)
    gains = torch.stack([red, torch.ones_like(red), blue], 1) / (red * blue)[:, None] ** (1 / 3)
    full = whole.ground.append(MODEL(light), ground) * (exposure * gains)[:, None]
    expected = albedo * (seen.transport.matrix @ full)
    if seen.specular is not None:
        expected = expected + shine[:, None] * (seen.specular.matrix @ full)
    (found,) = whole.shading(whole.unpack(whole.pack(*parameters())))
    torch.testing.assert_close(found, expected)


def test_parts_add_up_and_are_what_they_say():
    seen = observation()
    whole, given = objective(seen), parameters()
    free = whole.pack(*given)
    terms = whole.terms(free)
    torch.testing.assert_close(sum(terms.values()), whole(free))
    torch.testing.assert_close(whole(free)[1:3], whole(free[1:3]))
    # the priors of standard normals, written out; the azimuth (6) has none
    light = torch.cat([free[:, :6], free[:, 7:10]], 1)
    constant = 0.5 * np.log(2 * np.pi)
    torch.testing.assert_close(terms["light_prior"], 0.5 * (light**2).sum(1) + 9 * constant)
    log_albedo = given[3][:, 0].log()
    torch.testing.assert_close(terms["albedo_prior"], 0.5 * (log_albedo**2).sum(1) + 3 * constant)
    balance = given[5][:, 0] / WHITE_BALANCE_SPREAD
    torch.testing.assert_close(terms["white_balance_prior"], 0.5 * (balance**2).sum(1))
    gap = (whole.shading(whole.unpack(free))[0] - seen.pixels).abs().mean(2)
    data = 250 / 0.06 * (gap @ seen.weights) / seen.weights.sum()
    torch.testing.assert_close(terms["data"], data, atol=4.2, rtol=0)  # Charbonnier's 1e-3


def test_ground_and_specular_scale_are_drawn_to_the_usual():
    whole, (light, exposure, specular_scale, albedo, ground, _) = (
        objective(observation()),
        parameters(),
    )
    usual = whole.ground_prior.means[0].exp().expand(5, 3)
    terms = whole.terms(whole.pack(light, exposure, torch.ones(5, 1), albedo, usual))
    least = -whole.ground_prior.log_prob(whole.ground_prior.means)
    torch.testing.assert_close(terms["ground_prior"], least.expand(5), atol=1e-4, rtol=0)
    torch.testing.assert_close(terms["gloss_prior"], torch.zeros(5), atol=1e-9, rtol=0)
    terms = whole.terms(whole.pack(light, exposure, specular_scale, albedo, ground))
    assert (terms["ground_prior"] > least).all()
    assert (terms["gloss_prior"] > 0).all()


def test_a_white_balance_that_is_trusted_has_no_gains():
    seen, trusting = observation(), replace(WEIGHTS, white_balance_spread=0.0)
    whole = LightObjective([FaceTerm.of(seen)], MODEL, normal(9), normal(3), trusting)
    light, exposure, specular_scale, albedo, ground, balance = parameters()
    told = whole.pack(light, exposure, specular_scale, albedo, ground, balance)
    silent = whole.pack(light, exposure, specular_scale, albedo, ground)
    for gains, without in zip(
        whole.shading(whole.unpack(told)), whole.shading(whole.unpack(silent)), strict=True
    ):
        assert torch.equal(gains, without)
    assert torch.equal(whole.white_balance(whole.unpack(told)), torch.ones(5, 1, 3))
    # balances of 0 cost nothing and are what a picture without a cast is packed with
    assert torch.equal(
        silent, whole.pack(light, exposure, specular_scale, albedo, ground, 0 * balance)
    )
    assert (whole.terms(silent)["white_balance_prior"] == 0).all()


@pytest.mark.parametrize(
    "skin_spread", [*(pytest.param(s, marks=pytest.mark.slow) for s in (0.02, 0.1)), 0.5]
)
def test_a_cast_is_shared_out_between_camera_and_skin_by_their_variances(skin_spread):
    """Gaussian priors, the light known: normal equations say what of a cast u is the camera's.

    min_v |v|^2 / s^2 + |P (u - v)|^2 / t^2 over ratios to green, where |P w|^2 is the squared norm
    of (w_red, 0, w_blue) less its mean, which is exposure.
    """
    light, exposure, specular_scale, albedo, ground, _ = parameters(count=1)
    mean, spread = albedo[:, 0].log(), torch.eye(3)[None] / skin_spread
    skin = GaussianMixture(torch.ones(1), mean, spread)
    seen = observation(specular=False)
    known = LightObjective([FaceTerm.of(seen)], MODEL, normal(9), skin, UNEDITED)
    free = known.pack(light, exposure, specular_scale, albedo, ground)
    cast = torch.tensor([0.08, -0.1])
    factors = torch.tensor([cast[0], 0.0, cast[1]]).exp()
    pixels = known.shading(known.unpack(free))[0][0].detach() * factors
    whole = LightObjective(
        [FaceTerm.of(replace(seen, pixels=pixels))], MODEL, normal(9), skin, UNEDITED
    )
    held = MODEL.parameter_count

    def around(x, _):
        return whole(torch.cat([free[:, :held].expand(len(x), -1), x], 1))

    # by 1e-8 it may end 1.5e-3 away, by how sums are rounded
    found = minimise(around, free[:, held:], iterations=1000, tolerance=1e-12)
    balance = whole.unpack(torch.cat([free[:, :held], found.x], 1)).balance[0, 0]
    squared = torch.eye(2) - 1 / 3
    precision = torch.eye(2) / WHITE_BALANCE_SPREAD**2 + squared / skin_spread**2
    expected = torch.linalg.solve(precision, squared @ cast / skin_spread**2)
    torch.testing.assert_close(balance, expected, atol=1e-3, rtol=0)


EDIT = torch.tensor([0.3, -0.2], dtype=torch.float64)  # log saturation and contrast


def edit_objective(seen):
    return LightObjective([FaceTerm.of(seen)], MODEL, normal(9), normal(3), EDITED)


def told(whole, edits):
    """Some points of one picture that was edited."""
    light, exposure, shine, albedo, ground, balance = parameters()
    return whole.pack(light, exposure, shine, albedo, ground, balance, edits=edits)


def test_an_edit_is_what_the_camera_does_last_and_costs_its_squares():
    whole = edit_objective(observation())
    free, plain = told(whole, EDIT.expand(5, 1, 2)), told(whole, None)
    (before,) = whole.shading(whole.unpack(plain))
    (after,) = whole.shading(whole.unpack(free))
    torch.testing.assert_close(after, edited(before, *EDIT.exp()[:, None].expand(2, 5)))
    spreads = torch.tensor([EDITED.saturation_spread, EDITED.contrast_spread])
    cost = 0.5 * (EDIT / spreads).square().sum()
    torch.testing.assert_close(whole.terms(free)["edit_prior"], cost.expand(5))
    assert (whole.terms(plain)["edit_prior"] == 0).all()
    torch.testing.assert_close(whole.unpack(whole.at_bayes_scale(free)).edits, EDIT.expand(5, 1, 2))


def test_edits_that_are_ruled_out_and_the_saturation_of_grey_do_nothing():
    seen = observation()
    off = LightObjective([FaceTerm.of(seen)], MODEL, normal(9), normal(3), UNEDITED)
    free, plain = told(off, EDIT.expand(5, 1, 2)), told(off, None)
    for with_edit, without in zip(
        off.shading(off.unpack(free)), off.shading(off.unpack(plain)), strict=True
    ):
        assert torch.equal(with_edit, without)
    grey = edit_objective(replace(seen, grey=True))
    parts = grey.unpack(told(grey, EDIT.expand(5, 1, 2)))
    torch.testing.assert_close(grey.edits(parts)[0, 0], torch.tensor([1.0, float(EDIT[1].exp())]))


def test_the_edit_of_a_known_face_in_known_light_is_found():
    """What priors leave of it: the picture weighs some hundred times as much."""
    seen = observation(specular=False)
    whole = edit_objective(seen)
    light, exposure, shine, albedo, ground, _ = (p[:1] for p in parameters())
    edits = EDIT.expand(1, 1, 2)
    made = whole.pack(light, exposure, shine, albedo, ground, edits=edits)
    pixels = whole.shading(whole.unpack(made))[0][0].detach()
    whole = edit_objective(replace(seen, pixels=pixels))
    start = whole.pack(light, exposure, shine, albedo, ground)
    first = MODEL.parameter_count

    def around(x, _):
        camera = torch.cat([start[:, first : first + 3].expand(len(x), -1), x], 1)
        rest = start[:, first + 5 :].expand(len(x), -1)
        return whole(torch.cat([start[:, :first].expand(len(x), -1), camera, rest], 1))

    found = minimise(around, start[:, first + 3 : first + 5], iterations=200, tolerance=1e-9)
    torch.testing.assert_close(found.x[0], EDIT, atol=0.01, rtol=0)


def test_own_shading_leaves_no_residual():
    seen = observation()
    free = objective(seen).pack(*parameters())
    whole = objective(seen)
    for k in range(len(free)):
        own = whole.shading(whole.unpack(free[k : k + 1]))[0][0]
        data = objective(replace(seen, pixels=own.detach())).terms(free)["data"]
        assert float(data[k]) == pytest.approx(WEIGHTS.independent / WEIGHTS.noise * 1e-3)
        assert int(data.argmin()) == k


def test_pixels_without_weight_do_not_count():
    seen = observation()
    spoilt = replace(seen, pixels=torch.where(seen.weights[:, None] > 0, seen.pixels, 1e3))
    free = objective(seen).pack(*parameters())
    torch.testing.assert_close(objective(seen)(free), objective(spoilt)(free))


@pytest.mark.parametrize("specular", [True, False])
def test_slopes_are_those_of_finite_differences(specular):
    whole = objective(observation(specular=specular))
    free = whole.pack(*parameters(count=2)).requires_grad_(True)
    assert torch.autograd.gradcheck(whole, (free,), eps=1e-6, atol=1e-4, rtol=1e-5)


@pytest.mark.parametrize("level", [1, 2, 3])
def test_the_pyramid_commutes_with_shading(level):
    seen = observation()
    whole, free = objective(seen), objective(seen).pack(*parameters(count=1))
    shaded = replace(seen, pixels=whole.shading(whole.unpack(free))[0][0])
    coarse = shaded.coarser(level)
    smaller = objective(coarse)
    torch.testing.assert_close(coarse.pixels, smaller.shading(smaller.unpack(free))[0][0])
    assert len(coarse.pixels) < len(seen.pixels)
    torch.testing.assert_close(coarse.weights.sum(), seen.weights.sum())
    # by hand: weighted means over blocks of the picture
    for pixel, place in zip(coarse.pixels, coarse.places, strict=True):
        mine = (seen.places // 2**level == place).all(1).double() * seen.weights
        torch.testing.assert_close(pixel, mine @ shaded.pixels / mine.sum())
    assert coarse.coarser(0) is coarse


def test_two_small_steps_of_the_pyramid_are_one_large_one():
    once, twice = observation().coarser(2), observation().coarser(1).coarser(1)
    torch.testing.assert_close(once.places, twice.places)
    torch.testing.assert_close(once.pixels, twice.pixels)
    torch.testing.assert_close(once.transport.matrix, twice.transport.matrix)


def test_lower_bounds_make_blocks_of_their_own():
    seen = observation()
    clipped = torch.arange(len(seen.pixels)) % 3 == 0
    coarse = replace(seen, clipped=clipped).coarser(1)
    for part in (True, False):
        mine = clipped == part
        alone = Observation(
            pixels=seen.pixels[mine],
            weights=seen.weights[mine],
            places=seen.places[mine],
            transport=replace(seen.transport, matrix=seen.transport.matrix[mine]),
        ).coarser(1)
        torch.testing.assert_close(coarse.pixels[coarse.clipped == part], alone.pixels)
        torch.testing.assert_close(coarse.weights[coarse.clipped == part], alone.weights)
    once, twice = (
        replace(seen, clipped=clipped).coarser(2),
        coarse.coarser(1),
    )
    torch.testing.assert_close(once.pixels, twice.pixels)
    assert once.clipped is not None
    assert twice.clipped is not None
    assert torch.equal(once.clipped, twice.clipped)


def test_what_is_brighter_than_a_lower_bound_deviates_by_nothing():
    seen = observation()
    clipped = torch.arange(len(seen.pixels)) % 2 == 0
    face = FaceTerm.of(replace(seen, clipped=clipped))
    brighter, darker = face.deviation(torch.stack([seen.pixels + 0.1, seen.pixels - 0.1])).unbind()
    assert (brighter[clipped] == 0).all()
    torch.testing.assert_close(brighter[~clipped], torch.full_like(brighter[~clipped], 0.1))
    torch.testing.assert_close(darker, torch.full_like(darker, -0.1))
    assert (face.exact_share[0, clipped] == 0).all()
    torch.testing.assert_close(face.exact_share[0, ~clipped], face.share[0, ~clipped])


def tones(weights, means, spread):
    """Skins of a few grey tones."""
    log = torch.tensor(means).log()[:, None].expand(-1, 3)
    factors = (torch.eye(3) / spread).expand(len(means), 3, 3)
    return GaussianMixture(torch.tensor(weights), log.clone(), factors.clone())


def scaled_albedo(prior, albedo):
    """What the choice of scale makes of an albedo; the picture stays."""
    whole = LightObjective([FaceTerm.of(observation())], MODEL, normal(9), prior, WEIGHTS)
    light, exposure, specular_scale, _, ground, balance = parameters(count=1)
    albedo = torch.tensor(albedo).expand(1, 1, 3)
    free = whole.pack(light, exposure, specular_scale, albedo, ground, balance)
    after = whole.at_bayes_scale(free)
    same, other = whole.unpack(free), whole.unpack(after)
    torch.testing.assert_close(whole.shading(same)[0], whole.shading(other)[0])
    return float(other.albedo.mean())


@pytest.mark.parametrize(("dark", "wanted"), [(0.99, 0.05), (0.7, 0.4), (0.1, 0.4)])
def test_the_safest_albedo_is_the_weighted_median(dark, wanted):
    # light 8 times too bright (1/8 as likely would do) against light 7/8 too dark
    prior = tones([dark, 1 - dark], [0.05, 0.4], 0.1)
    assert scaled_albedo(prior, 0.1) == pytest.approx(wanted, rel=0.15)


def test_the_best_exposure_matches_the_mean():
    shading, target = torch.rand(4, 20, 3) + 0.1, torch.rand(1, 20, 3)
    share = torch.rand(1, 20, 1)
    share = share / share.sum() / 3
    exposed = best_exposure(shading, target, share)[:, None, None] * shading
    torch.testing.assert_close((exposed * share).sum((1, 2)), (target * share).sum().expand(4))
