"""Photographs under one lamp relit to another, scored against those under that one."""

import json
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from skylight.cli import main
from skylight.errors import InputError
from skylight.evaluation import (
    _known_faces as known_faces,
    _main as evaluations,
    _relit_lamps as relit_lamps,
)
from skylight.evaluation._known_faces import EstimateOptions
from skylight.evaluation._lamps import lamp_index, tinted
from skylight.evaluation._main import evaluate, run_evaluation
from skylight.evaluation._relit_lamps import RelitLamps
from skylight.evaluation._run import Item
from skylight.faces._observe import observe_face
from skylight.io._files import write_png
from skylight.portrait._relit import portrait_of
from tests.evaluation.test_relit_portraits import a_person

AHEAD, SIDE, BEHIND = [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]


def index(folder: Path, content: dict[str, list[float]]) -> Path:
    (folder / "lamps.json").write_text(json.dumps(content))
    lamp_index.cache_clear()
    return folder


def test_pairs_are_two_lamps_before_one_person(tmp_path: Path) -> None:
    lamps = {f"{person}_{k}.png": AHEAD for person in "ab" for k in range(5)}
    index(tmp_path, {**lamps, "a_5.png": SIDE, "a_6.png": BEHIND, "c_0.png": AHEAD})
    evaluation = RelitLamps(data=tmp_path)
    pairs = evaluation.pairs()
    assert len(pairs) == 2 * 3 * 3
    for name, (one, other) in pairs.items():
        assert one != other
        assert one[0] == other[0]
        assert {one, other} <= set(lamps)
        assert name == f"{one[:-4]}--{other[:-4]}"
    fewer = RelitLamps(data=tmp_path, sources=1, targets=2).items()
    assert len(fewer) == 2 * 2
    assert set(fewer) <= set(pairs)  # what a small run measured, the large one has
    assert RelitLamps(data=tmp_path, seed=1).items() != list(pairs)


def test_what_makes_no_pairs_is_refused(tmp_path: Path) -> None:
    index(tmp_path, {"a_0.png": AHEAD, "a_1.png": BEHIND, "b_0.png": AHEAD})
    with pytest.raises(InputError, match="no person of its lamps"):
        RelitLamps(data=tmp_path)
    index(tmp_path, {"a_0.png": AHEAD, "a_1.png": AHEAD})
    with pytest.raises(InputError, match=r"such as a_\d--a_\d\.png"):
        RelitLamps(data=tmp_path).with_peers({"theirs": tmp_path})
    (name, *_) = RelitLamps(data=tmp_path).items()
    (tmp_path / f"{name}.png").touch()
    for ours in ("relit", "truth"):
        with pytest.raises(InputError, match="another name"):
            RelitLamps(data=tmp_path).with_peers({ours: tmp_path})
    with pytest.raises(InputError, match="leave --peer out"):
        evaluate("sky-models", quick=True, data=None, out=tmp_path, peers={"theirs": tmp_path})


@pytest.mark.parametrize(
    ("name", "given", "said"),
    [
        ("relit-lamps", ["theirs"], "--peer theirs: give NAME=FOLDER"),
        ("relit-lamps", ["a=x", "a=y"], "--peer a=y: give NAME=FOLDER, each name once"),
        ("relit-lamps", ["a=nowhere"], "nowhere: no relit picture of a pair in it"),
        ("all", ["a=x"], "--peer is of one evaluation"),
    ],
)
def test_peers_of_the_command_line_are_refused_in_a_line(
    name: str, given: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    index(tmp_path, {"a_0.png": AHEAD, "a_1.png": AHEAD})
    command = ["evaluate", name, "--data", str(tmp_path), "--out", str(tmp_path / "out")]
    assert main([*command, *(f"--peer={peer}" for peer in given)]) == 2
    assert said in capsys.readouterr().err.replace("\n", " ")


def test_the_command_that_is_recorded_names_every_peer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    index(tmp_path, {"a_0.png": AHEAD, "a_1.png": AHEAD})
    peers = [tmp_path / name for name in ("one", "two")]
    for folder in peers:
        folder.mkdir()
        for pair in RelitLamps(data=tmp_path).items():
            (folder / f"{pair}.png").touch()
    given = [f"--peer={folder.name}={folder}" for folder in peers]
    ran: list[tuple[RelitLamps, str]] = []

    def kept(run: RelitLamps, out: Path, *, command: str, **_: object) -> Path:
        ran.append((run, command))
        out.mkdir()
        (out / "results.md").touch()
        return out / "results.md"

    monkeypatch.setattr(evaluations, "run_evaluation", kept)
    command = ["evaluate", "relit-lamps", "--data", str(tmp_path), "--out", str(tmp_path / "out")]
    assert main([*command, *given]) == 0
    ((run, recorded),) = ran
    assert run.peers == (("one", peers[0]), ("two", peers[1]))
    assert recorded.endswith(" --peer one=one --peer two=two")


def test_a_peer_is_to_be_beaten_in_every_metric(tmp_path: Path) -> None:
    index(tmp_path, {"a_0.png": AHEAD, "a_1.png": AHEAD})

    def row(rmse: float, ssim: float, blotch: float) -> dict[str, float]:
        return {"srgb_rmse_skin": rmse, "srgb_ssim_skin": ssim, "blotch_skin": blotch}

    rows = {
        "relit": row(0.1, 0.8, 0.2),
        "transfer": row(0.4, 0.7, 0.2),
        "unchanged": row(0.5, 0.6, 0.3),
        "theirs": row(0.2, 0.9, 0.1),
    }
    evaluation = RelitLamps(data=tmp_path)
    (name, *_) = evaluation.items()
    (tmp_path / f"{name}.png").touch()
    evaluation = evaluation.with_peers({"theirs": tmp_path})
    assert isinstance(evaluation, RelitLamps)
    summary = {name: {} for name in rows}
    checks = evaluation.checks(summary, [Item(name="a", metrics=rows)])
    assert checks["mean srgb_rmse_skin over that of transfer"].value == pytest.approx(0.25)
    assert {name: check.ok for name, check in checks.items()} == {
        "mean srgb_rmse_skin over that of transfer": True,
        "mean srgb_rmse_skin over that of unchanged": True,
        "mean blotch_skin over that of unchanged": True,
        "mean srgb_ssim_skin over that of unchanged": True,
        "mean srgb_rmse_skin over that of theirs": True,
        "mean blotch_skin over that of theirs": False,
        "mean srgb_ssim_skin over that of theirs": False,
    }


def test_a_person_is_relit_from_lamp_to_lamp(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From as few pixels as show a face, by the light that is found in the shortest time.

    A peer is the truth itself, at another size and level.
    """
    monkeypatch.setattr(EstimateOptions, "light", "sh9")
    monkeypatch.setattr(known_faces, "observe_face", partial(observe_face, face_height_px=36))
    monkeypatch.setattr(relit_lamps, "portrait_of", partial(portrait_of, face_px=32))
    relit_lamps._taken_apart.cache_clear()
    lamps, codes = {}, {}
    for column in (1, 14):  # to the right and to the left of the camera's back
        person = a_person(column)
        green = person.picture[..., 1]
        codes[f"a_{column}.png"] = (200 * green / green.max()).byte().numpy()
        cv2.imwrite(str(tmp_path / f"a_{column}.png"), codes[f"a_{column}.png"])
        lamps[f"a_{column}.png"] = person.environment.brightest_direction().tolist()
    evaluation = RelitLamps(data=index(tmp_path, lamps), sources=1)
    ((name, (_, other)),) = evaluation.pairs().items()
    (tmp_path / "theirs").mkdir()
    double = np.kron(tinted((0.8 * codes[other]).astype(np.uint8)), np.ones((2, 2, 1), np.uint8))
    write_png(tmp_path / "theirs" / f"{name}.png", double)
    before = evaluation.config()
    with_peers = evaluation.with_peers({"theirs": tmp_path / "theirs"})
    assert with_peers.config() != before
    assert isinstance(with_peers, RelitLamps)
    out = tmp_path / "out"
    results = json.loads(run_evaluation(with_peers, out, command="c").read_text())
    rmse = {row: metrics["srgb_rmse_skin"]["mean"] for row, metrics in results["rows"].items()}
    assert set(rmse) == {"relit", "unchanged", "theirs", "transfer"}
    assert rmse["theirs"] < 0.01
    assert rmse["relit"] < rmse["unchanged"]
    assert results["items"][name]["degrees between the lamps"] > 30
    assert (out / "sheet.png").is_file()

    small = cv2.resize(codes[other], (72, 72))
    cv2.imwrite(str(tmp_path / other), small)
    with pytest.raises(InputError, match="of another size"):
        evaluation.measure(name, tmp_path / "picture.png")
