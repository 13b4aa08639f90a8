"""Graphs of ``torch.compile`` and ``torch.export`` beyond the contract of all modules."""

import runpy
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor

from skylight.models import LightModel
from skylight.probes.voxel import VoxelProbe, star_probe
from skylight.sphere import DirectionGrid
from skylight.sphere._frame import angle_between
from tests.modules import CASES, F32, F64, GRID, Case, diffuse, error, random

LIGHTS = ["sunsky", "lamps", "harmonics", "gaussians", "autoencoder light, coarse"]


def whole(function: Callable, backend: str = "aot_eager") -> Callable:
    torch.compiler.reset()
    return torch.compile(function, backend=backend, fullgraph=True)


def test_a_graph_follows_what_its_values_derive_from() -> None:
    transport, light = diffuse(), random(1, len(GRID), 3)
    compiled = whole(transport)
    before = compiled(light)
    with torch.no_grad():
        transport.normals.mul_(-1)
    assert error(compiled(light), transport(light)) < 1e-12
    assert error(compiled(light), before) > 0.1


def test_frozen_normals_stay() -> None:
    transport, light = diffuse(), random(1, len(GRID), 3)
    frozen, before = transport.freeze(), transport(light)
    with torch.no_grad():
        transport.normals.mul_(-1)
    assert torch.equal(frozen(light, 0.5), 0.5 * before)
    assert list(frozen.state_dict()) == ["matrix"]


def test_a_graph_may_make_grids_of_its_own() -> None:
    def light(x: Tensor) -> Tensor:
        one, other = DirectionGrid.latlong(4), DirectionGrid.sky(6)
        return x * (one.directions.sum() + other.solid_angles.sum())

    x = torch.ones(1, dtype=F64)
    assert error(whole(light)(x), light(x)) < 1e-14


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow if "auto" in n else ()) for n in LIGHTS]
)
def test_a_fit_on_the_free_side_is_one_graph(name: str) -> None:
    """The other methods of a light model."""
    model, (params,) = CASES[name].single(), CASES[name].given(F32)

    def roundtrip(params: Tensor) -> tuple[Tensor, ...]:
        free = model.to_free(params)
        sun = model.sun_direction(params) if isinstance(model, LightModel) else None
        return model.from_free(free), *([] if sun is None else [sun])

    for found, expected in zip(whole(roundtrip, "eager")(params), roundtrip(params), strict=True):
        assert error(found, expected) < 1e-6


@pytest.mark.slow
def test_a_probe_s_albedo_is_learnt_through_a_graph() -> None:
    """Its transfer is an operator of the graph, with a gradient."""
    probe, light = VoxelProbe(star_probe(3), size=2, degree=2), random(1, len(GRID), 3)
    slopes = [
        torch.autograd.grad(call(light, GRID).square().mean(), probe.albedo)[0]
        for call in (probe, whole(probe))
    ]
    assert error(slopes[1], slopes[0]) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sunsky", "autoencoder light, coarse", "diffuse transport"])
def test_machine_code_is_the_same(name: str) -> None:
    case = CASES[name]
    module, (x, *rest) = case.single(), case.given(F32)
    results = []
    for call in (case.call, whole(case.call, "inductor")):
        at = x.clone().requires_grad_()
        value = call(module, at, *rest)
        results.append([value, *torch.autograd.grad(value.square().mean(), at)])
    for found, expected in zip(*results, strict=True):
        assert error(found, expected) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("name", [*LIGHTS, "mixture", "prior of lamps", "diffuse transport"])
def test_onnxruntime_gives_the_same_for_any_batch(name: str) -> None:
    onnxruntime = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    case: Case = CASES[name]
    (given,) = case.given(F32)

    class Called(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.module = case.single()

        def forward(self, x: Tensor) -> Tensor:
            return case.call(self.module, x)

    called = Called()
    program = torch.onnx.export(
        called,
        (given,),
        dynamic_shapes=({0: torch.export.Dim("batch")},),
        dynamo=True,
        verbose=False,
    )
    assert program is not None
    session = onnxruntime.InferenceSession(program.model_proto.SerializeToString())
    for some in (given[:1], torch.cat([given, given])):
        (found,) = session.run(None, {session.get_inputs()[0].name: some.numpy()})
        assert error(torch.from_numpy(found), called(some)) < 1e-4


def test_the_example_of_the_page(tmp_path: Path) -> None:
    """With the quickest compiler."""
    example = runpy.run_path(str(Path(__file__).parents[1] / "examples/compile_and_export.py"))
    file, sky, true = str(tmp_path / "sky.pt2"), example["SKY"], example["TRUE"]
    example["write"](file)
    suns = (sky.sun_direction(params) for params in (true, example["fit"]("eager")))
    assert float(angle_between(*suns).rad2deg()) < 1
    params = true.expand(3, -1)
    assert error(torch.export.load(file).module()(params), sky(params)) < 1e-6
