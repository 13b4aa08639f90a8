"""All evaluations in one run, with one that costs nothing and one without its data."""

import pytest

from skylight.errors import InputError
from skylight.evaluation import _main as every, _main as main
from tests.evaluation.test_run import Counting, measured


@pytest.fixture
def told(monkeypatch, tmp_path):
    """The data that each of two evaluations, one of a folder of its own, was given."""
    given = {}

    def counting(name):
        def made(quick, data):
            given[name] = data
            if data is not None and not data.is_dir():
                raise InputError(f"{data}: there is no | such folder")
            return Counting(count=2, marks=tmp_path / "marks")

        return made

    table = {name: counting(name) for name in ("sky-models", "lamps", "voxel-probe")}
    for module in (main, every):
        monkeypatch.setattr(module, "EVALUATIONS", table)
    return given


def test_one_page_has_what_was_measured_and_what_was_left_out_and_why(tmp_path, told):
    data, out = tmp_path / "data", tmp_path / "out"
    data.mkdir()
    (out / "sky-models").mkdir(parents=True)
    (out / "sky-models" / "curve.png").touch()  # this evaluation has no pictures of its own
    page = every.evaluate_all(quick=True, data=data, out=out, workers=1)
    assert told == {"sky-models": None, "lamps": data / "lamps", "voxel-probe": data}
    text = page.read_text()
    assert "| lamps | 0.0 | left out: " in text
    assert "there is no / such folder |" in text  # a table's cell ends with a stroke
    assert "\n## voxel-probe\n" in text
    assert "\n## lamps\n" not in text
    assert "| MAE (s) | 0.5 ± 0.5 [0.5] |" in text
    assert "![sky-models: curve.png](sky-models/curve.png)" in text
    assert measured(tmp_path / "marks") == ["0", "1", "0", "1"]
    every.evaluate_all(quick=True, data=data, out=out, workers=1)
    assert measured(tmp_path / "marks") == ["0", "1", "0", "1"]  # it goes on


def test_without_any_result_it_is_refused(tmp_path, told):
    with pytest.raises(InputError, match="no such folder"):
        every.evaluate_all(quick=True, data=tmp_path / "none", out=tmp_path / "out")
    told.clear()
    (tmp_path / "data").mkdir()
    with pytest.raises(InputError, match=r"nothing could be evaluated; .*results\.md"):
        every.evaluate_all(quick=True, data=tmp_path / "data", out=tmp_path / "out", workers=0)
