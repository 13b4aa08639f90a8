"""Decoders of sparse codes as ONNX: onnxruntime alone makes the maps that torch makes."""

import json
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from skylight.cli import main
from skylight.csc import CodeTensors, FilterBank, SphericalSparseCoder
from skylight.errors import InputError, SkylightError
from skylight.maps import _export_codes as export
from skylight.maps._export_codes import bound, export_codes
from tests.csc.draws import random

EXAMPLE = Path(__file__).parents[2] / "examples/deploy_dictionary.py"
ALONE = """
import sys, json, numpy, onnxruntime
session = onnxruntime.InferenceSession(sys.argv[1])
given = dict(numpy.load(sys.argv[2]))
numpy.save(sys.argv[3], session.run(["map"], given)[0])
assert "torch" not in sys.modules and "skylight" not in sys.modules
print(json.dumps(session.get_modelmeta().custom_metadata_map))
"""


def coder() -> SphericalSparseCoder:
    """Filters and boxes of pixels."""
    return SphericalSparseCoder(FilterBank(random(4, 16), "box"), height=8, activations=6)


@pytest.mark.parametrize("rows", [pytest.param(None, marks=pytest.mark.slow), 12])
def test_onnxruntime_alone_decodes_what_torch_decodes(tmp_path: Path, rows: int | None) -> None:
    of, path = coder(), tmp_path / "codes.onnx"
    assert export_codes(of, path, rows=rows) < bound(of)
    codes = of(random(1, 8, 16, 3, seed=1).abs().float() + 0.01)  # other sizes than the exporter's
    codes = codes._replace(rotations=codes.rotations.float())
    names = "filters", "rotations", "weights"
    given = {name: each.numpy() for name, each in zip(names, codes, strict=False)}
    np.savez(tmp_path / "codes.npz", **given)
    arguments = [tmp_path / name for name in ("codes.onnx", "codes.npz", "map.npy")]
    told = subprocess.run(
        [sys.executable, "-c", ALONE, *arguments], check=True, capture_output=True, text=True
    )
    exact = CodeTensors(codes[0], codes[1].double(), codes[2].double(), codes[3])
    expected = of.decode(exact, rows).detach().numpy()
    error = np.abs(np.load(tmp_path / "map.npy") - expected).max()
    assert error <= bound(of) * float(codes.weights.abs().sum())
    facts = json.loads(told.stdout)
    said = [facts[name] for name in ("height", "rows", "filter_count", "activations", "banded")]
    assert said == ["8", str(rows or 8), "40", "6", "false"]
    assert facts["fingerprint"] == of.bank.fingerprint
    assert "radians" in facts["rotations"]


def test_a_graph_that_differs_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(export, "_graph", lambda *_: b"")
    for wrong in (2e-3, float("nan")):
        monkeypatch.setattr(
            export,
            "decoded_by",
            lambda _, codes, wrong=wrong: coder().decode(codes).detach().numpy() + wrong * 100,
        )
        with pytest.raises(SkylightError, match="differ from torch's"):
            export_codes(coder(), tmp_path / "codes.onnx")
    with pytest.raises(InputError, match="ask for 8 to"):
        export_codes(coder(), tmp_path / "codes.onnx", rows=7)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_the_command_writes_a_dictionary_of_a_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    FilterBank(random(3, 9), "mine").save(tmp_path / "mine.safetensors")
    options = ["--dictionary", str(tmp_path / "mine.safetensors"), "--height", "8"]
    assert main(["export", "codes", *options, "--out", str(tmp_path / "mine.onnx")]) == 0
    assert (tmp_path / "mine.onnx").stat().st_size > 1000
    assert "differ by" in capsys.readouterr().out


@pytest.mark.slow
def test_the_example(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", [str(EXAMPLE), str(tmp_path / "codes.onnx")])
    found = runpy.run_path(str(EXAMPLE))
    with torch.no_grad():
        expected = found["coder"].decode(found["codes"]).numpy()
    np.testing.assert_allclose(found["decoded"], expected, atol=1e-5)
    assert np.abs(expected - found["maps"].numpy()).mean() < 0.1
