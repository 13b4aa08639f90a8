"""The Jacobian of the faces' deviations: that of the whole objective, differentiated exactly."""

from dataclasses import replace

import pytest
import torch

from skylight.inverse._background import ROW_WEIGHT
from skylight.inverse._descent import (
    Iterates,
    Stage,
    descend,
    deviations,
    deviations_apart,
    jacobian,
)
from skylight.inverse._faces import FaceTerm, Level, ObjectiveWeights
from skylight.inverse._objective import LightObjective
from skylight.inverse._sun_prior import SunPrior, found_light
from skylight.models._lamps import LampsLight, LampsPrior
from skylight.models._prior import convex_shape
from skylight.models._sphere import SphereLight, SpherePrior
from skylight.transport._normal_modes import NormalModes
from tests.inverse.test_objective import MODEL, ROWS, normal, observation
from tests.models.test_sphere import small_places

pytestmark = pytest.mark.usefixtures("double")
WEIGHTS = ObjectiveWeights(pigment_spread=1.0, normal_spread=0.5)


def first(transport, points):
    return replace(transport, matrix=transport.matrix[:points])


def face(*, pixels=64, specular=True, turned=True, uneven=True, clipped=False, grey=False):
    seen = observation(specular=specular)
    seen = replace(
        seen,
        pixels=seen.pixels[:pixels],
        weights=seen.weights[:pixels],
        places=seen.places[:pixels],
        transport=first(seen.transport, pixels),
        specular=None if seen.specular is None else first(seen.specular, pixels),
    )
    generator = torch.Generator().manual_seed(4)
    count = len(seen.pixels)
    if turned:
        normals = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=1)
        modes = 0.3 * torch.randn(count, 3, 5, generator=generator)
        errors = NormalModes.of(seen.transport, normals, modes, ROWS)
        seen = replace(seen, normal_modes=errors)
    if uneven:
        seen = replace(seen, modes=0.4 * torch.randn(count, 4, generator=generator))
    if clipped:
        seen = replace(seen, clipped=seen.pixels.mean(1) > 0.7)
    return replace(seen, grey=grey)


def check(objective, problem=None):
    free = 0.5 * torch.randn(4, objective.size, generator=torch.Generator().manual_seed(3))
    found = jacobian(objective, free, problem)
    free.requires_grad_()
    value = deviations(objective, free, problem)
    faces = deviations_apart(objective, free, problem)[0].shape[1]
    # faces and backgrounds apart: rows of the latter are small, and count the more
    groups = [(slice(faces), 1e-4), (slice(faces, None), 1e-4 / ROW_WEIGHT)]
    v = torch.zeros_like(value).requires_grad_()
    (pulled,) = torch.autograd.grad(value, free, v, create_graph=True)  # J^T v
    for column in range(objective.size):
        (expected,) = torch.autograd.grad(pulled[:, column].sum(), v, retain_graph=True)
        # where a clamp begins, the difference is about it
        off = (found[:, :, column] - expected).abs()
        for rows, least in groups[: 1 + (faces < off.shape[1])]:
            scale = float(expected[:, rows].abs().amax())
            assert float(off[:, rows].max()) < 0.05 * scale + least, column
            assert float(off[:, rows].square().mean().sqrt()) < 2e-3 * scale + least, column
    return found


@pytest.mark.parametrize(
    "kind",
    [
        {},
        {"specular": False, "turned": False, "uneven": False},
        {"clipped": True},
        {"grey": True, "uneven": False},
    ],
)
def test_under_a_sky(kind):
    seen = FaceTerm.of(face(**kind))
    objective = LightObjective([seen], MODEL, normal(9), normal(3), WEIGHTS)
    found = check(objective)
    assert bool((found.abs().amax((0, 1)) > 0)[-3:].all())  # the ground's albedo


def test_under_lamps_on_the_whole_sphere():
    model = LampsLight(2, 2 * ROWS)
    seen = FaceTerm.of(face(), sphere=True)
    check(LightObjective([seen], model, LampsPrior(2), normal(3), WEIGHTS))


def test_under_light_of_any_place():
    check(any_place())


def test_a_prior_that_offers_its_curvature_is_taken_at_its_word():
    """The slope is that of all priors; what is not light bends as differences say."""
    objective = any_place()
    free = 0.5 * torch.randn(2, objective.size, generator=torch.Generator().manual_seed(3))
    slope, hessian = objective.prior_shape(free)
    _, expected = convex_shape(lambda x, _: objective.prior(x), free, torch.arange(2))
    leaf = free.clone().requires_grad_()
    (whole,) = torch.autograd.grad(objective.prior(leaf).sum(), leaf)
    torch.testing.assert_close(slope, whole)
    lights = objective.model.parameter_count
    rest = slice(lights, None)
    torch.testing.assert_close(
        hessian[:, rest, rest], expected[:, rest, rest], rtol=1e-3, atol=2e-3
    )
    assert float(hessian[:, :lights, rest].abs().max()) == 0
    at = objective.model.azimuth_index
    assert float(hessian[:, at].abs().max()) == float(hessian[:, :, at].abs().max()) == 0


def test_what_clock_and_place_tell_bends_nothing_but_lamps_and_the_azimuth():
    told, plain = any_place(found_light(torch.tensor([0.6, 0.6, 0.5]))), any_place()
    free = 0.5 * torch.randn(2, told.size, generator=torch.Generator().manual_seed(3))
    slope, hessian = told.prior_shape(free)
    leaf = free.clone().requires_grad_()
    (whole,) = torch.autograd.grad(told.prior(leaf).sum(), leaf)
    torch.testing.assert_close(slope, whole)
    other, before = told.prior_shape(free, clock=False)
    expected = plain.prior_shape(free)
    torch.testing.assert_close((other, before), expected)
    more = hessian - before
    assert float(more[:, : told.model.latents].abs().max()) == 0
    assert float(torch.linalg.eigvalsh(more)[:, 0].min()) > -1e-6


def test_groups_of_starts_descend_together_as_each_alone():
    objective = any_place()
    free = 0.3 * torch.randn(5, objective.size, generator=torch.Generator().manual_seed(7))
    scores = objective(free)
    stage = Stage(level=Level(0), starts=2, iterations=4, steps="broyden")
    groups = [Iterates.starting(free[:3], scores[:3]), Iterates.starting(free[3:], scores[3:])]
    for group, found in zip(groups, descend(objective, groups, stage, 1e-6), strict=True):
        (alone,) = descend(objective, [group], stage, 1e-6)
        assert len(found.free) == 2
        assert float(found.scores.min()) < float(group.scores.min())
        torch.testing.assert_close(found.scores, alone.scores)
        torch.testing.assert_close(found.free, alone.free)


def any_place(sun: SunPrior | None = None) -> LightObjective:
    places = small_places()
    model = SphereLight(1, 2 * ROWS, places).double()
    seen = FaceTerm.of(face(), sphere=True)
    prior = SpherePrior(1, places).double()
    return LightObjective([seen], model, prior, normal(3), WEIGHTS, [sun])


def test_of_two_faces_in_two_photographs():
    """Each face's exposure is its photograph's."""
    first, second = face(), face(clipped=True)
    faces = [FaceTerm.of(first), replace(FaceTerm.of(second), photo=1)]
    objective = LightObjective(faces, MODEL, normal(9), normal(3), WEIGHTS)
    found = check(objective)
    pixels = found.shape[1] // 2
    exposures = MODEL.parameter_count, MODEL.parameter_count + 5
    assert float(found[:, pixels:, exposures[0]].abs().max()) == 0
    assert float(found[:, :pixels, exposures[1]].abs().max()) == 0


def test_of_faces_in_two_problems():
    one, other = face(), face(pixels=40, clipped=True)
    terms = FaceTerm.together([FaceTerm.of(one), FaceTerm.of(other)])
    objective = LightObjective([terms], MODEL, normal(9), normal(3), WEIGHTS)
    check(objective, torch.tensor([0, 0, 0, 1]))


def test_single_precision_is_near_double() -> None:
    """Estimates take it: forward differences have errors of rounding there."""
    seen = face(specular=False, turned=False, uneven=False)
    transport = replace(seen.transport, matrix=seen.transport.matrix.float())
    rounded = replace(seen, pixels=seen.pixels.float(), weights=seen.weights.float())
    rounded = replace(rounded, transport=transport)
    found = []
    for one in (seen, rounded):
        dtype = one.pixels.dtype
        torch.set_default_dtype(dtype)
        objective = LightObjective(
            [FaceTerm.of(one)], MODEL.to(dtype), normal(9).to(dtype), normal(3).to(dtype), WEIGHTS
        )
        free = 0.5 * torch.linspace(-1, 1, objective.size, dtype=dtype)[None]
        found.append(jacobian(objective, free)[0].double())
    exact, single = found
    off = (single - exact).norm(dim=0)
    assert 0 < float(off.max() / exact.norm(dim=0).max()) < 5e-3
