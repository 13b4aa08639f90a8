"""Light models of the user's own: they are fitted as ours are, or refused in one line."""

import copy
import math
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn
from torch.distributions import Independent, MultivariateNormal, Normal

from skylight.errors import InputError
from skylight.inverse._descent import Stage
from skylight.inverse._estimate import estimate_each, estimate_light, light_problems
from skylight.inverse._faces import Level
from skylight.inverse._own_light import _moved, told
from skylight.inverse._result import Estimate
from skylight.inverse._sky import SolverOptions, environment_of
from skylight.inverse._sun_prior import SunPart, SunPrior
from skylight.models._base import ParametricLight
from skylight.models._bundle import Model, load_bundle
from skylight.models._harmonic import HarmonicLight
from skylight.models._lamps import LampsLight, LampsPrior
from skylight.models.sunsky import SunSky
from skylight.sphere._frame import DirectionGrid, angle_between, direction_from_angles
from skylight.transport._observation import Observation
from tests.inverse.test_solve import ALBEDO, SUNS, watched

FEW = SolverOptions(
    scan_candidates=3,
    stages=(
        Stage(level=Level(2, light=1), starts=2, iterations=6),
        Stage(level=Level(1), starts=1, iterations=8, steps="gauss-newton"),
    ),
)


def lobe(towards: Tensor, directions: Tensor) -> Tensor:
    """20 at unit vectors (..., 3), 10 degrees wide."""
    return 20 * torch.exp(-16 * (directions - towards[..., None, :]).square().sum(-1, keepdim=True))


class Lantern(ParametricLight):
    """Even light and a lamp, anywhere on the sphere: their log colours, and its direction."""

    def __init__(self, height: int = 32) -> None:
        super().__init__(9, height, sphere=True)

    def sun_direction(self, params: Tensor) -> Tensor:
        return nn.functional.normalize(params[..., 6:], dim=-1)

    def forward(self, params: Tensor) -> Tensor:
        even, lamp = params[..., None, :6].exp().split(3, -1)
        return even + lamp * lobe(self.sun_direction(params), self.directions)

    def starts_towards(self, directions: Tensor) -> Tensor:
        return torch.cat([directions.new_zeros(len(directions), 6), directions], 1)[:, None]


class Dome(ParametricLight):
    """An even sky and a sun: their colours, the sun's azimuth and zenith angle."""

    def __init__(self, height: int = 32) -> None:
        low, high = [0.0] * 6 + [-math.inf, 0.0], [math.inf] * 7 + [math.pi / 2]
        super().__init__(8, height, low=low, high=high, azimuth_index=6)

    def sun_direction(self, params: Tensor) -> Tensor | None:
        return direction_from_angles(params[..., 6], params[..., 7])

    def forward(self, params: Tensor) -> Tensor:
        even, sun = params[..., None, :6].split(3, -1)
        towards = direction_from_angles(params[..., 6], params[..., 7])
        return even + sun * lobe(towards, self.directions)


def lit_by(light: ParametricLight, params: list[float]) -> Observation:
    """The ball of :func:`watched` in that light, on the rows of its transport."""
    seen, _ = watched(*SUNS[0])
    assert seen.specular is not None
    rows = 64 if light.grid.is_sphere else 32
    radiance = light.on_rows(rows)(torch.tensor(params))
    if not light.grid.is_sphere:
        radiance = torch.cat([radiance, torch.full_like(radiance, 0.1)])
    diffuse = torch.from_numpy(ALBEDO).float() * (seen.transport.matrix @ radiance)
    return replace(seen, pixels=1.7 * (diffuse + seen.specular.matrix @ radiance))


def found(seen: Observation, light: Any, **settings: Any) -> Estimate:
    return estimate_light(seen, light, options=FEW, device="cpu", **settings)


def test_a_lamp_below_the_horizon_is_found() -> None:
    """The picture is the model's own, so its lamp comes back to a hundredth of a degree."""
    angles = torch.tensor([130.0, 110.0], dtype=torch.float64).deg2rad()
    towards = direction_from_angles(*angles)
    seen = lit_by(Lantern(), [-1.0, -0.8, -0.5, 0.5, 0.4, 0.3, *towards.tolist()])
    light = found(seen, Lantern())
    assert math.degrees(angle_between(light.sun_direction, towards)) < 0.1
    assert light.environment.layout == (256, 512)
    assert (light.light, light.faces[0].residual < 0.01) == ("Lantern", True)
    assert light.posterior.grid.is_sphere
    assert light.verdict.direction.word == "sure"
    assert "light_prior" not in light.terms


DOME = [0.5, 0.6, 0.9, 1.5, 1.4, 1.2, 2.4, 0.7]


@pytest.fixture(scope="module")
def under_dome() -> Observation:
    return lit_by(Dome(), DOME)


class OwnRows(Dome):
    def on_rows(self, height: int) -> "OwnRows":
        raise NotImplementedError


class Stubborn(Dome):
    def on_rows(self, height: int) -> "Stubborn":
        return self


@pytest.mark.parametrize(
    "light",
    [
        lambda: Stubborn(24).double(),
        pytest.param(Dome, marks=pytest.mark.slow),
        pytest.param(lambda: Dome(16), marks=pytest.mark.slow),
        pytest.param(OwnRows, marks=pytest.mark.slow),
    ],
    ids=["always 24 rows, double", "32 rows", "16 rows", "no other rows"],
)
def test_a_sun_is_found_on_any_rows(light: Callable[[], Dome], under_dome: Observation) -> None:
    """Within half a pixel of the coarsest, 90 / 16 degrees, in which it is told."""
    light_found = found(under_dome, light())
    towards = direction_from_angles(*torch.tensor(DOME[6:], dtype=torch.float64))
    assert math.degrees(angle_between(light_found.sun_direction, towards)) < 2.9
    assert light_found.environment.layout == (256, 512)
    assert light_found.params.shape == (8,)


def test_a_prior_counts_on_the_free_side_without_the_azimuth(under_dome: Observation) -> None:
    """A narrow one about other colours than the picture's draws them there."""
    centre = torch.tensor([-2.0] * 3 + [1.0] * 3 + [0.0])
    narrow = MultivariateNormal(centre.double(), 1e-6 * torch.eye(7).double())
    light = found(under_dome, Dome(), prior=narrow)
    assert light.terms["light_prior"] > -100
    free = Dome().to_free(light.params)
    torch.testing.assert_close(free[:6], centre[:6], rtol=0, atol=0.02)


def test_ours_as_objects_are_as_by_their_names() -> None:
    """To the bit, since what follows is the same."""
    seen, _ = watched(*SUNS[0])
    quick = SolverOptions(stages=(Stage(level=Level(3, light=1), starts=2, iterations=3),))
    cases: list[tuple[Any, Any, Any]] = [
        ("sunsky", SunSky(), load_bundle().sunsky_prior),
        ("sh9", HarmonicLight(2, 16), None),
    ]
    for name, light, prior in cases:
        a, b = (
            estimate_light(seen, one, prior=over, options=quick, device="cpu")
            for one, over in ((name, None), (light, prior))
        )
        assert (a.light, a.status, a.terms) == (b.light, b.status, b.terms)
        assert torch.equal(a.params, b.params)
        assert torch.equal(a.environment.radiance, b.environment.radiance)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("light", "prior"),
    [
        (lambda: SunSky(16), None),
        (lambda: HarmonicLight(2), Independent(Normal(torch.zeros(27), torch.ones(27)), 1)),
        (lambda: LampsLight(1), LampsPrior(1)),
        (lambda: LampsLight(2), None),
        (lambda: load_bundle().light(), load_bundle().prior()),
        (lambda: load_bundle().light(), None),
    ],
    ids=["sunsky", "sh9 with a prior", "a lamp", "two lamps", "autoencoder", "without a prior"],
)
def test_ours_as_objects_find_the_sun(light: Callable[[], Any], prior: Any) -> None:
    seen, _ = watched(*SUNS[0])
    light_found = estimate_light(seen, light(), prior=prior, device="cpu")
    angles = torch.tensor(SUNS[0], dtype=torch.float64).deg2rad()
    off = angle_between(light_found.sun_direction.double(), direction_from_angles(*angles))
    assert math.degrees(off) < 5
    assert light_found.verdict.direction.word == "sure"


def test_what_is_given_stays_as_it_is(under_dome: Observation) -> None:
    """It is copied: neither moved nor put into evaluation mode, and may be trained meanwhile."""
    light = Dome()
    light.colour = nn.Parameter(torch.ones(3))
    light.train()
    problem, other = light_problems(light, 2, options=FEW, device="cpu")
    assert light.training
    assert light.colour.requires_grad
    assert problem.grid_height == other.grid_height == 64


@pytest.mark.slow
def test_each_of_several_has_its_own(under_dome: Observation) -> None:
    (one,) = estimate_each([under_dome], Dome(), options=FEW, device="cpu")
    assert torch.equal(one.params, found(under_dome, Dome()).params)


# ------------------------------------------------------------------------------- refusals


class Bare(nn.Module):
    def forward(self, params: Tensor) -> Tensor:
        return params


def without(member: str) -> object:
    """The dome with one member less."""

    class Incomplete:
        def __getattr__(self, name: str) -> Any:
            if name == member or name.startswith("__"):
                raise AttributeError(name)
            return getattr(dome, name)

        __call__ = None if member == "__call__" else lambda self, params: dome(params)

    dome = Dome()
    return Incomplete()


class Negative(Dome):
    def forward(self, params: Tensor) -> Tensor:
        return super().forward(params) - 5


class Undefined(Dome):
    def forward(self, params: Tensor) -> Tensor:
        return super().forward(params) / 0 * 0


class Grey(Dome):
    def forward(self, params: Tensor) -> Tensor:
        return super().forward(params)[..., 0]


class Detached(Dome):
    def forward(self, params: Tensor) -> Tensor:
        return super().forward(params).detach()


class Unbounded(Dome):
    def from_free(self, free: Tensor) -> Tensor:
        return free


class Flat(Dome):
    def starts_towards(self, directions: Tensor) -> Tensor:
        return self.starts()


class Scattered(Dome):
    def __init__(self) -> None:
        super().__init__()
        self.grid = DirectionGrid.hammersley(100)


class Turned(Dome):
    def __init__(self) -> None:
        super().__init__()
        self.azimuth_index = 8


class HalfTurned(ParametricLight):
    def __init__(self) -> None:
        super().__init__(8, low=-math.pi, high=math.pi, azimuth_index=6)

    def forward(self, params: Tensor) -> Tensor:
        return Dome.forward(self, params)  # pyright: ignore[reportArgumentType]


class Boundless(Dome):
    bounds = None  # pyright: ignore[reportAssignmentType]


class Whole(Dome):
    """Starts in whole numbers."""

    def starts(self) -> Tensor:
        return torch.ones(1, 8, dtype=torch.long)


class Distant(Dome):
    """A sun that is no direction but a place."""

    def sun_direction(self, params: Tensor) -> Tensor:
        return 3 * direction_from_angles(params[..., 6], params[..., 7])


class Batched(Lantern):
    """Of (b, p) parameters alone."""

    def sun_direction(self, params: Tensor) -> Tensor:
        return nn.functional.normalize(params[:, 6:], dim=-1)


class Striped(Dome):
    """It keeps more than directions for each pixel, and says nothing of other rows."""

    def __init__(self) -> None:
        super().__init__()
        self.stripes = torch.ones(len(self.grid), 1)

    def forward(self, params: Tensor) -> Tensor:
        return super().forward(params) * self.stripes


class Logged(Dome):
    """What cannot be copied."""

    def __init__(self) -> None:
        super().__init__()
        self.lock = threading.Lock()


@pytest.mark.parametrize(
    ("light", "message"),
    [
        (Bare(), "Bare is no light model: it lacks name"),
        *((without(m), f"lacks {m} ") for m in ("bounds", "starts_towards", "on_rows", "to_free")),
        (Dome, r"is the class Dome: give a model, Dome\(\)"),
        (3, "int is no light model"),
        ("dome", "unknown light model 'dome'"),
        (Negative(), r"Negative \('Negative'\): radiance at its starts is negative"),
        (Undefined(), "Undefined.*not finite"),
        (Grey(), r"Grey.*radiance must have the shape \(1, 4096, 3\), not \(1, 4096\)"),
        (Detached(), "Detached.*has no gradient"),
        (Unbounded(), "Unbounded.*from_free leaves its bounds"),
        (Flat(), r"Flat.*starts_towards must have the shape \(2, k, 8\)"),
        (Scattered(), r"Scattered.*grid must be DirectionGrid.latlong"),
        (Turned(), r"Turned.*azimuth_index must be one of 0 to 7"),
        (HalfTurned(), "HalfTurned.*parameter 6 is the azimuth.*without bounds"),
        (Boundless(), "Boundless.*bounds must be two tensors"),
        (Whole(), r"Whole.*starts\(\) must be .* in floating point"),
        (Distant(), r"Distant.*unit vectors, not of length \[\[[23]\."),
        (Batched(), r"Batched.*sun_direction must have the shape \(2, 1, 3\)"),
        (Striped(), r"Striped.*fails on the rows \(128, 512\) of its on_rows \(The size"),
        (Logged(), "Logged.*cannot be copied .*lock.*detached tensors"),
    ],
)
def test_what_is_no_light_is_refused(light: Any, message: str, under_dome: Observation) -> None:
    with pytest.raises(InputError, match=message):
        found(under_dome, light)


@pytest.mark.parametrize(
    ("prior", "message"),
    [
        (3, r"int is no prior: it lacks log_prob.*\(1, 7\) of Dome.*all but the azimuth"),
        (
            load_bundle().sunsky_prior,
            "GaussianMixture is no prior.*: GaussianMixture's parameters of shape",
        ),
        (Normal(torch.zeros(7), 1.0), r"Normal.log_prob.*must have the shape \(1\), not \(1, 7\)"),
    ],
)
def test_what_is_no_prior_is_refused(prior: Any, message: str, under_dome: Observation) -> None:
    with pytest.raises(InputError, match=message):
        found(under_dome, Dome(), prior=prior)


def test_options_of_others_are_refused(under_dome: Observation) -> None:
    clock = SunPrior(parts=(SunPart(share=1.0, zenith_rad=0.5),))
    model: Model = load_bundle()
    with pytest.raises(InputError, match="another light than Lantern"):
        found(under_dome, Lantern(), sun_prior=clock)
    with pytest.raises(InputError, match="sunsky has its own, leave prior out"):
        found(under_dome, "sunsky", prior=model.sunsky_prior)
    with pytest.raises(InputError, match=r"Dome.* is a model itself"):
        found(under_dome, Dome(), model=model)
    with pytest.raises(InputError, match="Dome needs transport of 64 rows"):
        found(under_dome.on_rows(32), Dome())


class Weighted:
    """No module: its tensors are attributes."""

    def __init__(self) -> None:
        self.spread = torch.ones(7)
        # meta tensors have no values to check
        normal = Normal(torch.zeros(7), torch.ones(7), validate_args=False)
        self.normal = Independent(normal, 1, validate_args=False)

    def log_prob(self, free: Tensor) -> Tensor:
        return self.normal.log_prob(free / self.spread)


@pytest.mark.slow
def test_whatever_holds_tensors_is_moved() -> None:
    """To the meta device, as to any other; what was given stays where it is."""
    given = Weighted()
    moved = _moved(given, torch.device("meta"), "the prior")
    assert moved.log_prob(torch.zeros(2, 7, device="meta")).device.type == "meta"
    assert given.log_prob(torch.zeros(2, 7)).device.type == "cpu"


def test_light_that_turns_negative_on_the_way_is_refused() -> None:
    with pytest.raises(InputError, match="Negative: radiance at the parameters found is negative"):
        environment_of(Negative(), torch.tensor(DOME), torch.zeros(3), 1.0)


def test_errors_in_a_model_s_own_code_are_shown_as_they_are(under_dome: Observation) -> None:
    """Neither as no other rows nor as another reason."""

    class Misspelt(Dome):
        def on_rows(self, height: int) -> "Misspelt":
            return self.missing(height)  # pyright: ignore[reportCallIssue]

    with pytest.raises(AttributeError, match="missing"):
        found(under_dome, Misspelt())


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (torch.zeros(2), torch.ones(2)),
        ([1.0], [2.0]),
        ({"red": 1}, {"red": 2}),
        (np.zeros(2), np.ones(2)),
        (np.float32(1), np.float32(2)),
        (Normal(0.0, 1.0), Normal(0.0, 2.0)),
        (None, 0),
    ],
    ids=["tensor", "list", "dict", "array", "number of numpy", "distribution", "None"],
)
def test_notes_tell_whatever_a_model_keeps(one: object, other: object) -> None:
    """Not in buffers alone, of modules and of other objects: else old results would be taken."""

    class Kept:
        def __init__(self, value: object) -> None:
            self.value = value

    def of(value: object) -> Dome:
        light = Dome()
        light.colour = value  # pyright: ignore[reportArgumentType]
        return light

    assert told(of(one)) == told(of(copy.deepcopy(one))) != told(of(other))
    assert told(Kept(one)) == told(Kept(copy.deepcopy(one))) != told(Kept(other))


def test_notes_leave_out_what_modules_compute() -> None:
    light = load_bundle().light()
    before = told(light)
    light(light.starts()[:1])
    assert told(light.train()) == before


def test_notes_tell_models_apart() -> None:
    """By their numbers and class, whatever was computed with them."""
    used = Dome()
    used(torch.tensor(DOME))
    assert told(Dome()) == told(used) == told(Dome().eval())
    apart = [told(one) for one in (Dome(), Dome(16), OwnRows(), LampsPrior(1), LampsPrior(2))]
    normals = [told(Independent(Normal(torch.full((2,), x), 1.0), 1)) for x in (0.0, 1.0)]
    every = [*apart, *normals]
    assert all(a != b for k, a in enumerate(every) for b in every[:k])
