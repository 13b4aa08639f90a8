"""Several photographs, each in a light of its own, solved as one batch: each as if alone."""

import copy
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from skylight._names import LightName
from skylight.errors import InputError
from skylight.inverse._auto import AutoProblem
from skylight.inverse._descent import Stage
from skylight.inverse._estimate import estimate_each, estimate_light, light_problems
from skylight.inverse._faces import FaceTerm, Level, ObjectiveWeights
from skylight.inverse._objective import LightObjective
from skylight.inverse._problem import solve
from skylight.inverse._result import Estimate
from skylight.inverse._scan import scan_faces
from skylight.inverse._sky import SkyProblem, SkySolver, SolverOptions
from skylight.models.sunsky import SunSky
from skylight.sphere._envmap import luminance
from skylight.transport._matrix import TransportMatrix
from skylight.transport._observation import Observation
from tests.inverse.test_solve import ALBEDO_PRIOR, MODES, SUNS, SUNSKY_PRIOR, harmonic_ball, watched

FEW = SolverOptions(
    stages=(
        Stage(level=Level(3), starts=4, iterations=6),
        Stage(level=Level(2), starts=2, iterations=4),
        Stage(level=Level(0), starts=1, iterations=3),
    )
)

FEWER = SolverOptions(stages=(Stage(level=Level(2), starts=2, iterations=3),))


def part(observation: Observation, kept: Tensor) -> Observation:
    """Some of its pixels."""

    def rows(transport: TransportMatrix) -> TransportMatrix:
        return replace(transport, matrix=transport.matrix[kept])

    assert observation.specular is not None
    return Observation(
        pixels=observation.pixels[kept],
        weights=observation.weights[kept],
        places=observation.places[kept],
        transport=rows(observation.transport),
        specular=rows(observation.specular),
    )


def double(observation: Observation) -> Observation:
    def moved(transport: TransportMatrix) -> TransportMatrix:
        return replace(transport, matrix=transport.matrix.double())

    return replace(
        observation,
        pixels=observation.pixels.double(),
        weights=observation.weights.double(),
        transport=moved(observation.transport),
        specular=None if observation.specular is None else moved(observation.specular),
    )


@pytest.fixture(scope="module")
def seen() -> list[Observation]:
    """A whole ball, half of one, a diffuse one, and one whose brightest pixels are clipped."""
    whole, half, diffuse, bright = (watched(*sun)[0] for sun in (*SUNS, SUNS[0]))
    level = luminance(bright.pixels)
    white = float(level.quantile(0.8))
    return [
        whole,
        part(half, half.places[:, 1] < 10),
        replace(diffuse, specular=None),
        replace(bright, pixels=bright.pixels.clamp(max=white), clipped=level > white),
    ]


def assert_alike(found: Estimate, alone: Estimate, tolerance: float) -> None:
    """Relative: of the objective and, against the brightest, of light and shading."""
    for name, value in alone.terms.items():
        assert found.terms[name] == pytest.approx(value, rel=tolerance, abs=100 * tolerance)
    for one, other in (
        (found.environment.radiance, alone.environment.radiance),
        (found.rendered, alone.rendered),
        (found.albedo, alone.albedo),
        (found.posterior.density, alone.posterior.density),
    ):
        assert float((one - other).abs().max() / other.max()) < tolerance
    assert found.verdict.summary == alone.verdict.summary
    assert found.faces[0].residual == pytest.approx(alone.faces[0].residual, rel=tolerance)
    assert found.status == alone.status
    assert found.stats["evaluations"] == alone.stats["evaluations"]


@pytest.mark.slow
def test_each_problem_of_a_batch_ends_as_alone(seen: list[Observation]) -> None:
    """In float64, where 13 iterations leave roundings small: the same path to the end."""
    first = SkyProblem(
        SunSky().double(),
        copy.deepcopy(SUNSKY_PRIOR).double(),
        copy.deepcopy(ALBEDO_PRIOR).double(),
        MODES.double(),
        FEW,
    )
    problems, alone = [first, *(first.another() for _ in seen[1:])], []
    for problem, observation in zip(problems, seen, strict=True):
        problem.add(double(observation))
        single = first.another()
        single.add(double(observation))
        alone.append(solve([single])[0])
    told: list[float] = []
    found = solve(problems, told.append)
    assert told == sorted(told)
    assert told[-1] == 1
    assert len({len(one.rendered) for one in found}) == 2  # some were padded
    assert len({one.stats["evaluations"] for one in found}) > 1  # line searches differ
    for one, other in zip(found, alone, strict=True):
        assert_alike(one, other, 1e-6)


def together(observations: list[Observation], light: LightName) -> list[Estimate]:
    """As one batch, on the CPU too."""
    problems = light_problems(light, len(observations), options=FEWER, device="cpu")
    skies = [problem for problem in problems if isinstance(problem, SkyProblem)]
    for problem, observation in zip(skies, observations, strict=True):
        problem.add(observation)
    return solve(skies)


@pytest.mark.slow
@pytest.mark.parametrize("light", ["sunsky", "autoencoder"])
def test_the_light_of_each_observation_is_its_own(
    seen: list[Observation], light: LightName
) -> None:
    """In float32 the same but for its roundings, which few iterations amplify to 1 %."""
    two = [seen[1], seen[3]]  # fewer pixels, clipped ones
    found = together(two, light)
    alone = estimate_each(two, light, options=FEWER, device="cpu")
    for one, other in zip(found, alone, strict=True):
        white = other.environment.radiance.max()
        error = (one.environment.radiance - other.environment.radiance).abs().max()
        assert float(error / white) < 0.01
        off = (one.rendered - other.rendered).abs().max() / other.rendered.max()
        assert float(off) < 0.01
        assert sum(one.terms.values()) == pytest.approx(sum(other.terms.values()), rel=1e-3)
    assert float(found[0].sun_direction @ found[1].sun_direction) < 0.9  # not one light for all


@pytest.mark.slow
def test_each_observation_has_a_choice_of_its_own(seen: list[Observation]) -> None:
    two, told = [seen[1], seen[3]], []
    problems = light_problems("auto", 2, options=FEWER, device="cpu")
    autos = [problem for problem in problems if isinstance(problem, AutoProblem)]
    for problem, observation in zip(autos, two, strict=True):
        problem.add(observation)
    found = solve(autos, told.append)
    assert told == sorted(told)
    assert told[-1] == 1
    for one, observation in zip(found, two, strict=True):
        alone = estimate_light(observation, "auto", options=FEWER, device="cpu")
        assert one.light == alone.light
        for name, nats in alone.choice.log_evidence.items():
            assert one.choice.log_evidence[name] == pytest.approx(nats, abs=1)


def test_harmonics_are_solved_one_after_the_other() -> None:
    balls, told = [harmonic_ball(degree)[1] for degree in (2, 4)], []
    found = estimate_each(balls, "sh9", progress=told.append)
    assert told == [0.5, 1.0]
    for one, ball in zip(found, balls, strict=True):
        assert torch.equal(one.params, estimate_light(ball, "sh9").params)


@pytest.mark.slow
def test_several_faces_a_problem_keep_their_photographs(seen: list[Observation]) -> None:
    """Two problems of two photographs each: those of the second are not those of the first."""
    options = SolverOptions(stages=(Stage(level=Level(2), starts=1, iterations=2),))
    first = SkyProblem(SunSky(), SUNSKY_PRIOR, ALBEDO_PRIOR, MODES, options)
    problems = [first, first.another()]
    for problem, (one, other) in zip(problems, [(1, 0), (0, 3)], strict=True):
        problem.add(seen[one], 0)
        problem.add(seen[other].scaled(3.0), 1)
    found = solve(problems)
    for problem, one in zip(problems, found, strict=True):
        alone = solve([problem])[0]
        assert [face.photo for face in one.faces] == [0, 1]
        for face, expected in zip(one.faces, alone.faces, strict=True):
            assert len(face.rendered) == len(expected.rendered)
            assert face.exposure == pytest.approx(expected.exposure, rel=0.01)


def test_an_objective_of_several_problems_is_that_of_each(seen: list[Observation]) -> None:
    """Values and slopes in float64, whatever of the problems' points are asked for."""
    faces = [FaceTerm.of(double(seen[k])) for k in (0, 1, 3)]
    faces[1] = replace(faces[1], level=torch.tensor([0.5]).double())
    generator = torch.Generator().manual_seed(5)
    faces = [
        replace(face, modes=torch.randn(1, face.target.shape[1], 3, generator=generator).double())
        for face in faces
    ]
    model, weights = SunSky().double(), ObjectiveWeights(pigment_spread=1.0)

    def objective(face: FaceTerm) -> LightObjective:
        return LightObjective([face], model, SUNSKY_PRIOR, ALBEDO_PRIOR, weights)

    problem = torch.tensor([0, 0, 0, 2])  # none of the second
    light = model.starts().double()[[0, 4, 8, 11]]
    together = objective(FaceTerm.together(faces))
    free = together.pack(
        light,
        torch.linspace(0.5, 2, 4).double()[:, None],
        torch.linspace(0.7, 1.4, 4).double()[:, None],
        MODES[:4, None].double(),
        torch.full((4, 3), 0.2).double(),
        pigments=0.1 * torch.randn(4, 1, 2, 3, generator=generator).double(),
    ).requires_grad_(True)
    (slope,) = torch.autograd.grad(together(free, problem).sum(), free)
    for row, p in enumerate(problem.tolist()):
        point = free[row : row + 1]
        value = objective(faces[p])(point)
        torch.testing.assert_close(together(free, problem)[row : row + 1], value)
        (alone,) = torch.autograd.grad(value.sum(), point)
        torch.testing.assert_close(slope[row : row + 1], alone)


def test_scans_do_not_depend_on_how_many_are_made_at_once(seen: list[Observation]) -> None:
    scanned = [one.coarser(1).on_rows(32) for one in seen]
    for one, other in zip(scan_faces(scanned, at_once=4), scan_faces(scanned), strict=True):
        torch.testing.assert_close(one.unexplained, other.unexplained, rtol=1e-9, atol=1e-12)
        torch.testing.assert_close(one.strengths, other.strengths, rtol=1e-9, atol=1e-12)
        torch.testing.assert_close(one.deviations, other.deviations, rtol=1e-9, atol=1e-12)
        assert one.without_sun == pytest.approx(other.without_sun, rel=1e-9)


def test_no_photographs_have_no_lights() -> None:
    assert estimate_each([]) == estimate_each([], "sh9") == solve([]) == []


def test_problems_that_share_no_solver_are_refused(seen: list[Observation]) -> None:
    problems = [SkyProblem(SunSky(), SUNSKY_PRIOR, ALBEDO_PRIOR, MODES) for _ in range(2)]
    for problem in problems:
        problem.add(seen[0])
    with pytest.raises(ValueError, match="share a solver"):
        solve(problems)


def test_an_empty_problem_among_others_is_refused_before_any_is_solved(
    seen: list[Observation], monkeypatch: pytest.MonkeyPatch
) -> None:
    first = SkyProblem(SunSky(), SUNSKY_PRIOR, ALBEDO_PRIOR, MODES)
    first.add(seen[0])
    monkeypatch.setattr(SkySolver, "solve", lambda *_: pytest.fail("solved"))
    with pytest.raises(InputError, match="no observation"):
        solve([first, first.another()])


@pytest.mark.parametrize("photos", [[1, 1], [0, 2], [0]])
def test_photographs_are_counted_from_0_without_gaps(
    seen: list[Observation], photos: list[int]
) -> None:
    with pytest.raises(InputError, match="counted from 0"):
        estimate_light(seen[:2], "sh9", photos=photos)


@pytest.mark.parametrize("light", ["sh9", "sunsky"])
def test_a_black_face_is_refused(seen: list[Observation], light: LightName) -> None:
    black = replace(seen[0], pixels=torch.zeros_like(seen[0].pixels))
    with pytest.raises(InputError, match="mean luminance of 0"):
        estimate_light(black, light)
