"""Several faces under one light: what they share, what each has for itself."""

import math
from dataclasses import replace

import pytest
import torch

from skylight.inverse._descent import Stage
from skylight.inverse._faces import FaceTerm, Level, ObjectiveWeights
from skylight.inverse._harmonic import HarmonicProblem
from skylight.inverse._objective import LightObjective
from skylight.inverse._problem import solve
from skylight.inverse._scan import SunScan, scan_faces
from skylight.inverse._sky import SkyProblem, SolverOptions
from skylight.models._harmonic import HarmonicLight
from skylight.models.sunsky import SunSky
from skylight.sphere._frame import DirectionGrid, direction_from_angles
from skylight.transport._matrix import TransportMatrix
from skylight.transport._observation import Observation
from tests.inverse.test_solve import ALBEDO_PRIOR, MODES, SUNSKY_PRIOR
from tests.oracles.harmonics import irradiance
from tests.oracles.outdoors import Outdoors

QUICK = SolverOptions(
    stages=(
        Stage(level=Level(3), starts=3, iterations=15),
        Stage(level=Level(1), starts=2, iterations=8),
        Stage(level=Level(0), starts=1, iterations=5),
    )
)
GROUND = torch.tensor([[0.15, 0.13, 0.11]])
SUN = (2.3, 0.8)  # azimuth, zenith


def half_ball_normals(turn_deg: float, side: int = 12) -> tuple[torch.Tensor, torch.Tensor]:
    """(pixels, normals) of a half ball that is turned aside about the vertical, as a face is."""
    line = (torch.arange(side) + 0.5) / side * 2 - 1
    y, x = torch.meshgrid(-line, line, indexing="ij")
    inside = x**2 + y**2 < 0.9
    places = torch.nonzero(inside)
    x, y = x[inside], y[inside]
    z = (1 - x**2 - y**2).sqrt()
    angle = math.radians(turn_deg)
    turned = (math.cos(angle) * x + math.sin(angle) * z, math.cos(angle) * z - math.sin(angle) * x)
    return places, torch.stack([turned[0], y, turned[1]], 1).double()


def half_ball(turn_deg: float = 0.0) -> Observation:
    """A diffuse half ball, white until it is lit."""
    places, normals = half_ball_normals(turn_deg)
    grid = DirectionGrid.latlong(64)
    cosine = (normals @ grid.directions.T).clamp(min=0)
    matrix = (cosine * grid.solid_angles / math.pi).float()
    return Observation(
        pixels=torch.ones(len(places), 3),
        weights=torch.ones(len(places)),
        places=places,
        transport=TransportMatrix(matrix=matrix, grid=grid),
    )


def sunny() -> torch.Tensor:
    colours = [0.45, 0.55, 0.8, 5.5, 5.0, 4.2]
    return torch.tensor([[*colours, *SUN, 3.5, 700.0]])


def lit(blank: Observation, albedo: torch.Tensor, exposure: float) -> Observation:
    """The half ball in the sunny sky over the ground."""
    objective = LightObjective(
        [FaceTerm.of(blank)], SunSky(), SUNSKY_PRIOR, ALBEDO_PRIOR, ObjectiveWeights()
    )
    free = objective.pack(
        sunny(), torch.tensor([[exposure]]), torch.ones(1, 1), albedo[None, None], GROUND
    )
    with torch.no_grad():
        return replace(blank, pixels=objective.shading(objective.unpack(free))[0][0])


def problem(options: SolverOptions = QUICK) -> SkyProblem:
    return SkyProblem(SunSky(), SUNSKY_PRIOR, ALBEDO_PRIOR, MODES, options)


def sun_error_deg(direction: torch.Tensor) -> float:
    truth = direction_from_angles(*torch.tensor(SUN).double())
    return math.degrees(math.acos(min(1.0, float(direction.double() @ truth))))


def test_each_face_adds_its_data_and_its_priors() -> None:
    """Two faces in two photographs: what each gives alone, less the light's priors once."""
    seen = [lit(half_ball(-30), MODES[0], 1.0), lit(half_ball(40), MODES[2], 1.0)]
    terms = [replace(FaceTerm.of(one), level=torch.tensor([0.5 + k])) for k, one in enumerate(seen)]
    model, weights = SunSky(), ObjectiveWeights()

    def objective(*faces: FaceTerm) -> LightObjective:
        return LightObjective(faces, model, SUNSKY_PRIOR, ALBEDO_PRIOR, weights)

    exposure, specular_scale = torch.tensor([[0.7, 1.9]]), torch.tensor([[0.6, 1.4]])
    albedo = MODES[None, 1:3]
    joint = objective(terms[0], replace(terms[1], photo=1))
    both = joint.terms(joint.pack(sunny(), exposure, specular_scale, albedo, GROUND))
    alone = []
    for k, term in enumerate(terms):
        one = objective(term)
        cut = slice(k, k + 1)
        free = one.pack(sunny(), exposure[:, cut], specular_scale[:, cut], albedo[:, cut], GROUND)
        alone.append(one.terms(free))
    for name in ("data", "albedo_prior", "gloss_prior"):
        torch.testing.assert_close(both[name], alone[0][name] + alone[1][name])
    for name in ("light_prior", "ground_prior"):
        torch.testing.assert_close(both[name], alone[0][name])


def test_a_dark_face_says_as_much_as_a_bright_one() -> None:
    """A face's evidence is relative to its own level, so a darker copy has the same."""
    bright = lit(half_ball(), MODES[3], 2.0)
    wrong = bright.pixels * torch.linspace(0.8, 1.2, len(bright.pixels))[:, None]
    term = FaceTerm.of(bright)
    dark = replace(term, target=term.target * 0.1, level=torch.tensor([0.1]))
    weights = ObjectiveWeights()
    torch.testing.assert_close(
        dark.data_term(0.1 * wrong[None], weights), term.data_term(wrong[None], weights)
    )


def test_the_scan_of_faces_is_the_mean_of_their_scans() -> None:
    faces = [lit(half_ball(turn), MODES[k], 1.0 + k) for k, turn in enumerate((-40, 10, 60))]
    scans = scan_faces(faces)
    joint = SunScan.of(scans)
    alone = torch.stack([SunScan.of([scan]).residuals ** 2 for scan in scans])
    torch.testing.assert_close(joint.residuals**2, alone.mean(0))
    assert sun_error_deg(joint.candidates[0]) < 6


@pytest.mark.slow
def test_a_face_twice_gives_the_light_of_once() -> None:
    """All of the objective but the priors on light doubles; with weak ones the minimum stays."""
    weak = ObjectiveWeights(light_prior=0.0, albedo_prior=1e-3, ground_prior=1e-3)
    patient = (
        Stage(level=Level(2), starts=2, iterations=40),
        Stage(level=Level(0), starts=1, iterations=60),
    )
    options = replace(QUICK, weights=weak, tolerance=1e-6, stages=patient)
    seen = lit(half_ball(20), MODES[1], 1.0)
    twice = problem(options)
    for photo in range(2):
        twice.add(seen, photo)
    found, once = solve([twice])[0], problem(options)
    once.add(seen)
    single = solve([once])[0]
    assert float(found.sun_direction @ single.sun_direction) > math.cos(math.radians(2))
    first, second = found.faces
    ratio = (first.exposure * first.albedo) / (second.exposure * second.albedo)
    torch.testing.assert_close(ratio, torch.ones(3), atol=0.03, rtol=0)


def test_faces_of_one_picture_keep_the_ratio_of_their_albedos() -> None:
    """Exposure and light are shared, so the ratio of albedos is in the pixels alone.

    The shading is a sum over the directions of another sky and a point sun, in float64.
    """
    sun = direction_from_angles(*torch.tensor(SUN).double())
    world = Outdoors(
        sun.numpy(), sky=[0.45, 0.55, 0.8], sun_irradiance=[5.5, 5.0, 4.2], ground=GROUND[0].numpy()
    )
    joint = problem()
    for turn, albedo in ((-25, MODES[1]), (25, MODES[3])):
        _, normals = half_ball_normals(turn)
        shading = torch.from_numpy(world.irradiance(normals.numpy())) / math.pi
        joint.add(replace(half_ball(turn), pixels=(1.7 * albedo * shading).float()))
    found = solve([joint])[0]
    assert sun_error_deg(found.sun_direction) < 5
    first, second = found.faces
    assert first.exposure == second.exposure == found.exposure
    torch.testing.assert_close(second.albedo / first.albedo, MODES[3] / MODES[1], rtol=0.06, atol=0)
    assert max(first.residual, second.residual) < 0.04


def test_more_faces_tell_more() -> None:
    """Blotches on every face, the light in common: the error falls from one face to four."""
    model = HarmonicLight(2, height=64)
    generator = torch.Generator().manual_seed(4)
    blanks = [half_ball(turn) for turn in (-50, -15, 20, 55)]

    def error(faces: list[Observation], light: torch.Tensor) -> float:
        """Of light whose level in each channel is not known, relative."""
        joint = HarmonicProblem(model, ALBEDO_PRIOR, MODES)
        for photo, face in enumerate(faces):
            joint.add(face, photo)
        # the fit alone: what follows it tells nothing of the light's shape
        found = model(joint._fit().product.float().reshape(1, -1))[0]
        return float((found / found.mean(0) - light / light.mean(0)).abs().mean())

    alone, together = [], []
    for _ in range(3):
        coefficients = 0.2 * torch.randn(9, 3, generator=generator)
        coefficients[0] = 4.0
        light = model(coefficients.reshape(1, -1))[0]
        faces = []
        for blank, albedo in zip(blanks, MODES[:4], strict=True):
            coarse = torch.randn(4, 4, generator=generator)
            blotches = (0.1 * coarse[blank.places[:, 0] // 3, blank.places[:, 1] // 3]).exp()
            shading = albedo * (blank.transport.matrix @ light)
            faces.append(replace(blank, pixels=shading * blotches[:, None]))
        alone += [error([face], light) for face in faces]
        together.append(error(faces, light))
    assert max(together) < min(alone)


def test_harmonic_light_is_shared() -> None:
    """The light of all faces together, albedo ratios exact within a picture.

    The shading is analytic: ``sum_lm A_l L_lm Y_lm(n) / pi`` (Ramamoorthi & Hanrahan 2001).
    """
    model = HarmonicLight(2, height=64)
    generator = torch.Generator().manual_seed(1)
    coefficients = 0.2 * torch.randn(9, 3, generator=generator)
    coefficients[0] = 4.0
    light = model(coefficients.reshape(1, -1))[0]
    assert (light > 0).all()
    joint = HarmonicProblem(model, ALBEDO_PRIOR, MODES)
    given = ((0, -60, MODES[2], 1.0), (0, 60, MODES[1], 1.0), (1, 10, MODES[2], 3.0))
    for photo, turn, albedo, exposure in given:
        _, normals = half_ball_normals(turn)
        shading = irradiance(coefficients, normals) / math.pi
        pixels = (exposure * albedo * shading).float()
        joint.add(replace(half_ball(turn), pixels=pixels), photo)
    found = solve([joint])[0]
    assert found.status == "converged"
    one, two, other = found.faces
    torch.testing.assert_close(two.albedo / one.albedo, MODES[1] / MODES[2], rtol=0.02, atol=0)
    product = other.albedo * other.exposure / one.albedo
    torch.testing.assert_close(product, torch.full((3,), 3.0), rtol=0.02, atol=0)
    assert max(face.residual for face in found.faces) < 0.01
    shape = found.environment.resize(64).flat * one.albedo / MODES[2]
    assert float((shape - light).abs().mean() / light.mean()) < 0.03
