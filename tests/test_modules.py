"""What every public module promises in every mode that torch may be in: one line each in CASES.

Precision: float32, bfloat16's autocast and TF32 are within stated bounds of float64, and what one
of them made does not outlast it. Modes: inference mode may come before training, transforms of
torch.func before copies and pickles. Devices: all of a module moves. Sizes: a wrong one is named.
"""

import copy
import importlib
import inspect
import io
import pickle
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import jaxtyping
import pytest
import torch
from torch import Tensor, nn
from torch.func import grad, jacfwd, jacrev, vmap
from torch.nn.functional import normalize

import skylight
from skylight.csc import SphericalSparseCoder
from skylight.errors import InputError
from skylight.models import GaussianLobes, LampsLight, LightModel, ParametricLight, SunSky
from skylight.models.sunsky import fit_sunsky
from skylight.transport._render import reflection_weights
from tests.modules import CASES, F32, F64, GRID, NOT_HERE, TF32, Case, coder as coder_of_few, error

PACKAGE = Path(skylight.__file__).parent


@pytest.fixture(
    params=[
        pytest.param(name, marks=pytest.mark.slow if case.slow else ())
        for name, case in CASES.items()
    ]
)
def case(request: pytest.FixtureRequest) -> Case:
    return CASES[request.param]


@pytest.fixture(
    params=[
        pytest.param(name, marks=pytest.mark.slow if case.slow or case.slow_graph else ())
        for name, case in CASES.items()
        if not case.no_graph
    ]
)
def traced(request: pytest.FixtureRequest) -> Iterator[Case]:
    yield CASES[request.param]
    torch.compiler.reset()


@pytest.fixture
def transformable(case: Case) -> Case:
    if not case.transforms:
        pytest.skip("a search, of which there is no derivative")
    return case


def public_modules() -> set[type[nn.Module]]:
    """Whatever a package's ``__init__.pyi`` names and is a module."""
    public = set()
    for stub in PACKAGE.rglob("__init__.pyi"):
        package = ".".join(("skylight", *stub.parent.relative_to(PACKAGE).parts))
        for name in re.findall(r"^    (\w+) as \1,$", stub.read_text(), re.MULTILINE):
            kind = getattr(importlib.import_module(package), name)
            if inspect.isclass(kind) and issubclass(kind, nn.Module):
                public.add(kind)
    return public


@pytest.mark.slow
def test_all_public_modules_are_here() -> None:
    """They are called by a case, and ``help`` tells what a call computes."""
    public = public_modules()
    called = {kind for kind in public if kind.forward is not nn.Module.forward}
    silent = {kind.__name__ for kind in called if len(kind.forward.__doc__ or "") < 30}
    assert (len(called) > 15, silent) == (True, set())
    tried = {type(part) for case in CASES.values() for part in case.make().modules()}
    assert {kind.__name__ for kind in public - tried} == NOT_HERE.keys()


def test_float32_is_float64_to_its_digits(case: Case) -> None:
    assert error(case.call(case.single(), *case.given(F32)), case.truth) < case.float32


def test_autocast_costs_its_bits_and_leaves_nothing(case: Case) -> None:
    module, given = case.single(), case.given(F32)
    before = case.call(case.single(), *given)
    with torch.autocast("cpu", torch.bfloat16):
        found = case.call(module, *given)
    assert error(found, case.truth) < case.autocast
    assert torch.equal(case.call(module, *given), before)


def test_tf32_costs_its_bits(case: Case) -> None:
    with TF32():
        found = case.call(case.single(), *case.given(F32))
    assert error(found, case.truth) < case.tf32


def test_inference_comes_before_training(case: Case) -> None:
    module, given = case.single().requires_grad_(True), case.given(F32)
    fresh, results = case.single().requires_grad_(True), []
    with torch.inference_mode():
        case.call(module, *given)
    for each in (module, fresh):
        moved = [x.clone().requires_grad_() for x in given]
        value = case.call(each, *moved)
        if value.requires_grad:
            value.square().mean().backward()
        results.append([value, *(x.grad for x in moved if x.grad is not None)])
    for found, expected in zip(*results, strict=True):
        assert torch.equal(found, expected)


def test_derivatives_forward_and_backward_are_the_differences(transformable: Case) -> None:
    """``<w, df/dx d>`` three ways, in float64; then the module is copied and pickled."""
    case, module = transformable, transformable.in_double().requires_grad_(False)
    x, *rest = case.given(F64)
    generator = torch.Generator().manual_seed(1)
    along = torch.randn(x.shape, generator=generator, dtype=F64)
    value = case.call(module, x, *rest)
    weights = torch.randn(value.shape, generator=generator, dtype=F64)

    def scalar(at: Tensor) -> Tensor:
        return (weights * case.call(module, at, *rest)).sum()

    def on_line(t: Tensor) -> Tensor:
        return scalar(x + t * along)

    step = torch.tensor(1e-7, dtype=F64)  # few kinks are so near
    differences = (on_line(step) - on_line(-step)) / (2 * step)
    scale = float(differences.abs()) + 1e-6 * float((weights * value).abs().sum()) + 1e-9
    forward = jacfwd(on_line)(torch.zeros((), dtype=F64))
    backward = (grad(scalar)(x) * along).sum()
    assert float((forward - differences).abs()) < 1e-4 * scale
    assert float((backward - differences).abs()) < 1e-4 * scale
    assert float((jacrev(on_line)(torch.zeros((), dtype=F64)) - forward).abs()) < 1e-8 * scale
    for again in (copy.deepcopy(module), pickle.loads(pickle.dumps(module))):
        assert torch.equal(case.call(again, x, *rest), value)


def test_vmap_is_a_loop(transformable: Case) -> None:
    case, module = transformable, transformable.single().requires_grad_(False)
    x, *rest = case.given(F32)
    both = torch.stack([x, x.flip(0)])
    found = vmap(lambda at: case.call(module, at, *rest))(both)
    expected = torch.stack([case.call(module, at, *rest) for at in both])
    assert error(found, expected) < 1e-4
    copy.deepcopy(module)
    pickle.dumps(module)


def _batches(case: Case, *counts: int) -> Iterator[list[Tensor]]:
    """The case's inputs, as many of each as asked for."""
    given = case.given(F32)
    size = given[0].shape[0]
    for count in counts if case.batch else [size]:
        repeated = [i % size for i in range(count)] if case.batch else list(range(size))
        yield [x[repeated] if x.shape[0] == size else x for x in given]


def test_compiled_it_is_the_same(traced: Case) -> None:
    """Values and gradients, by one graph for batches of any size but 1."""
    from torch._dynamo.testing import CompileCounterWithBackend  # takes seconds to import

    module, compiler = traced.single(), CompileCounterWithBackend("aot_eager")
    compiled = torch.compile(traced.call, backend=compiler, fullgraph=True)
    for given in _batches(traced, 2, 3):
        results = []
        for call in (compiled, traced.call):
            inputs = [x.clone().requires_grad_() for x in given]
            if traced.batch:
                for x in inputs:
                    torch._dynamo.maybe_mark_dynamic(x, 0)
            value = call(module, *inputs)
            leaves = [x for x in (*module.parameters(), *inputs) if x.requires_grad]
            grads = torch.autograd.grad(value.square().mean(), leaves, allow_unused=True)
            results.append([value, *(x for x in grads if x is not None)])
        for found, expected in zip(*results, strict=True):
            assert error(found, expected) < 1e-4
    assert compiler.frame_count == 1


class _Called(nn.Module):
    def __init__(self, case: Case) -> None:
        super().__init__()
        self.module, self.call = case.single(), case.call

    def forward(self, *inputs: Tensor) -> Tensor:
        return self.call(self.module, *inputs)


def test_exported_it_is_the_same(traced: Case) -> None:
    """Written, read, and run on batches of several sizes."""
    called = _Called(traced)
    (given,) = _batches(traced, 2)
    batch = {0: torch.export.Dim("batch")} if traced.batch else {}
    shapes = [batch if x.shape[0] == given[0].shape[0] else {} for x in given]
    program = torch.export.export(called, tuple(given), dynamic_shapes=(tuple(shapes),))
    file = io.BytesIO()
    torch.export.save(program, file)
    file.seek(0)
    read = torch.export.load(file).module()
    for inputs in _batches(traced, 1, 3):
        assert error(read(*inputs), called(*inputs)) < 1e-5


@pytest.mark.parametrize("name", [name for name, case in CASES.items() if case.no_graph])
def test_what_has_no_graph_is_refused(name: str) -> None:
    """With the reason, by the compiler as by the exporter."""
    case = CASES[name]
    called, given = _Called(case), case.given(F32)
    called(*given)  # makes its tables
    with pytest.raises(Exception, match=case.no_graph):
        torch.compile(called, backend="eager", fullgraph=True)(*given)
    with pytest.raises(InputError, match=case.no_graph):
        torch.export.export(called, tuple(given))


def test_all_of_it_moves_to_a_device(case: Case) -> None:
    if not case.meta:
        pytest.skip("what it computes depends on values")
    module = case.single().to("meta")
    found = case.call(module, *(x.to("meta") for x in case.given(F32)))
    assert (found.device.type, found.shape) == ("meta", case.truth.shape)
    if isinstance(module, LightModel):
        towards = torch.eye(3)[1:2]
        for of in (module.starts(), module.starts_towards(towards), *module.bounds):
            assert of.device.type == "meta"
        assert module.starts_towards(towards.to("meta")).device.type == "meta"


def test_a_wrong_size_is_named(case: Case) -> None:
    if case.axis is None:
        pytest.skip("its first input is of any size")
    x, *rest = case.given(F32)
    for wrong in (x.narrow(case.axis, 1, x.shape[case.axis] - 1), torch.cat([x, x], case.axis)):
        with pytest.raises(InputError, match=re.escape(str(tuple(wrong.shape)))):
            case.call(case.single(), wrong, *rest)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("sunsky", "SunSky's parameters of shape (2, 9): give (..., 10): RGB of the sky, RGB"),
        ("lamps", "LampsLight's parameters of shape (2, 9): give (..., 30): 16 of the ambient"),
        ("harmonics", "HarmonicLight's parameters of shape (2, 9): give (..., 75): 25 coeff"),
        ("gaussians", "GaussianLobes' parameters of shape (2, 9): give (..., 21): RGB, azimuth"),
        (
            "autoencoder light, coarse",
            "AutoencoderLight's parameters of shape (2, 9): give (..., 6",
        ),
        ("splines, decode", "SplineAutoencoder's latents of shape (2, 9): give (..., 64)"),
        ("mixture", "GaussianMixture's parameters of shape (2, 9): give (..., 64)"),
        ("prior of lamps", "LampsPrior's parameters of shape (2, 9): give (..., 30): 16 of the"),
    ],
)
def test_a_wrong_number_of_parameters_is_told_with_what_they_are(name: str, said: str) -> None:
    module = CASES[name].single()
    with pytest.raises(InputError, match=re.escape(said)):
        CASES[name].call(module, torch.ones(2, 9))
    for method in ("to_free", "from_free", "sun_direction"):
        if hasattr(module, method) and not isinstance(module, ParametricLight):
            with pytest.raises(InputError, match=re.escape(said)):
                getattr(module, method)(torch.ones(2, 9))


def test_a_search_finds_the_same_under_autocast() -> None:
    coder, maps = coder_of_few().float(), CASES["coder"].given(F32)[0]
    expected = coder(maps)
    with torch.autocast("cpu", torch.bfloat16):
        found = coder(maps)
    for one, other in zip(found, expected, strict=True):
        assert torch.equal(one, other)


def test_a_search_within_a_transform_is_refused_and_leaves_nothing() -> None:
    coder, maps = coder_of_few(), CASES["coder"].given(F64)[0]
    with pytest.raises(InputError, match="code the maps before"):
        grad(lambda x: coder.relative_error(x, coder(x)))(maps)
    codes = coder(maps)
    grad(lambda x: coder.relative_error(x, coder.refit(x, codes)))(maps)
    pickle.dumps(coder)


def _sunsky(kappa: Tensor) -> Tensor:
    sun = normalize(torch.tensor([[0.3, 0.5, -0.8]], dtype=F64)).to(kappa)
    return SunSky(16).sun_lobe(sun, kappa)


def _sun_pixels(kappa: Tensor) -> Tensor:
    """The whole model, with most light in the sun."""
    values = [0.2, 0.2, 0.2, 5.0, 5.0, 5.0, 0.7, 1.1, 2.5]
    params = torch.cat([torch.tensor([values], dtype=F64).to(kappa), kappa[:, None]], 1)
    return SunSky(16)(params)


def _lamps(kappa: Tensor) -> Tensor:
    model = LampsLight(1, 16)
    lamps = model.lamps(torch.tensor([[0.0] * 16 + [0.3, 0.5, -0.8] + [0.0] * 4]).to(kappa))
    return model.lobes(replace(lamps, widths_rad=kappa[:, None].rsqrt()))


def _gaussians(kappa: Tensor) -> Tensor:
    values = [1.0, 1.0, 1.0, 0.7, 1.1]
    params = torch.cat([torch.tensor([values], dtype=F64).to(kappa), kappa[:, None]], 1)
    return GaussianLobes(1, 16)(nn.functional.pad(params, (0, 3)))


@pytest.mark.parametrize("kappa", [8.0, 60.0, 1000.0, 8000.0])
@pytest.mark.parametrize("lobe", [_sunsky, _sun_pixels, _lamps, _gaussians])
def test_sharp_lobes_keep_their_energy(lobe: Callable[[Tensor], Tensor], kappa: float) -> None:
    """Pixels, and the energy that moves between them; float32 rounds an exponent of -90 by 1e-5."""
    truth = lobe(torch.tensor([kappa], dtype=F64))
    for mode in (torch.autocast("cpu", torch.bfloat16), TF32()):
        with mode:
            found = lobe(torch.tensor([kappa]))
        assert float((found - truth).abs().sum() / truth.sum()) < 2e-5
        assert error(found, truth) < 1e-4


def test_parameters_that_autocast_made_are_not_rounded_again() -> None:
    """A head of a network that predicts lights: its output has eight bits, the light all."""
    sunsky, lamps, gaussians = SunSky(8), LampsLight(2, 8), GaussianLobes(3, 8)
    some = torch.full((2, gaussians.parameter_count), 0.3)
    for model, params in (
        (sunsky, sunsky.starts()),
        (lamps, lamps.starts()),
        (gaussians, some),
    ):
        eight_bits = params.bfloat16()
        with torch.autocast("cpu", torch.bfloat16):
            found = model(eight_bits)
        assert torch.equal(found, model(eight_bits.float()))


def test_what_is_not_forward_is_the_same_under_autocast() -> None:
    sky = CASES["ground"].given(F32)[0] ** 6
    mixture = CASES["mixture"].single()
    for value in (
        lambda: fit_sunsky(sky, SunSky(8)),
        lambda: GaussianLobes(3, 8).matching_start(sky),
        lambda: mixture.covariances,
        lambda: mixture.widened(torch.eye(64)).precision_factors,
        lambda: reflection_weights(GRID.directions[:9].float(), GRID, 0.16),
    ):
        expected = value()
        with torch.autocast("cpu", torch.bfloat16):
            assert torch.equal(value(), expected)


@pytest.mark.slow
def test_a_search_with_tf32_finds_as_good_a_code() -> None:
    """Of filters whose correlations differ by less than 2^-10 it may take another."""
    coder = SphericalSparseCoder("ani", activations=12)
    generator = torch.Generator().manual_seed(4)
    maps = torch.rand(3, 32, 64, 3, generator=generator) ** 6
    with torch.no_grad():
        exact = coder.relative_error(maps, coder(maps))
        with TF32():
            codes = coder(maps)
        rounded = coder.relative_error(maps, codes)
    assert float((rounded / exact).log().abs().max()) < 0.01


@pytest.mark.parametrize(
    ("name", "wrong", "said"),
    [
        ("sky transport", {1: (2, 4)}, r"SkyTransport's ground of shape \(2, 4\): give"),
        ("sky transport", {2: (2, 4)}, r"SkyTransport's albedo of shape \(2, 4\): give"),
        (
            "slots",
            {0: (31, 6, 2, 2, 3)},
            r"DirectReconstruction's slots of shape \(31, 6, 2, 2, 3\): give",
        ),
        ("splines on a disk", {0: (5,)}, r"DiskSplines' control points of shape \(5,\): give"),
    ],
)
def test_wrong_sizes_of_other_inputs_are_named(
    name: str, wrong: dict[int, tuple[int, ...]], said: str
) -> None:
    given = list(CASES[name].given(F32))
    for place, shape in wrong.items():
        given[place] = torch.ones(shape)
    jaxtyping.config.update("jaxtyping_disable", True)  # users have no checks of annotations
    try:
        with pytest.raises(InputError, match=said):
            CASES[name].call(CASES[name].single(), *given)
    finally:
        jaxtyping.config.update("jaxtyping_disable", False)
