import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from skylight.errors import InputError
from skylight.io._files import read_environment_map
from skylight.skies import _simulated as simulated
from skylight.skies._index import centre_column_azimuth, load_skies, read_index
from skylight.skies._simulated import EVALUATION_SEEDS, simulate_folder, simulated_skies
from skylight.skies._simulator import draw_day
from skylight.sphere._envmap import EnvironmentMap


def simulate(out: Path, days: int = 2, workers: int = 1) -> Path:
    return simulate_folder(out, days=days, interval_min=300.0, height=8, workers=workers)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate(tmp_path_factory.mktemp("skies")).parent


def contents(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_index_of_simulated_days(folder: Path) -> None:
    records = read_index(folder)
    assert {r.file for r in records} == {p.name for p in folder.glob("*.exr")}
    assert {r.seed for r in records} == {0, 1}
    for r in records:
        day = draw_day(r.seed if r.seed is not None else -1)
        assert (r.day, r.regime) == (day.name, day.regime)
        assert (r.latitude_deg, r.longitude_deg) == (
            day.place.latitude_deg,
            day.place.longitude_deg,
        )
        assert 0 <= r.sun_zenith_deg < 88
        assert 0 <= r.sun_transmittance <= 1 + 1e-6
        assert r.map_azimuth_deg == pytest.approx(math.degrees(centre_column_azimuth(8)))
        assert r.split == "train"  # two days cannot be divided
    written = read_environment_map(folder / records[0].file).radiance
    torch.testing.assert_close(
        load_skies(folder, records, height=8)[0],
        written / (written.sum() / load_skies(folder, records[:1], height=8).sum()),
        rtol=1e-4,
        atol=1e-6,
    )


def test_days_already_there_are_kept(folder: Path, tmp_path: Path) -> None:
    """A run that stopped after the first day ends like one that did not."""
    simulate(tmp_path, days=1)
    before = (tmp_path / "days" / "0.csv").stat().st_mtime_ns
    left = tmp_path / "days" / ".partial-35cdcfb194cd.csv"  # of a run that was killed
    left.write_text("file,day\nhalf")
    seen: list[tuple[int, int]] = []
    simulate_folder(
        tmp_path,
        days=2,
        interval_min=300.0,
        height=8,
        progress=lambda done, of: seen.append((done, of)),
    )
    assert (tmp_path / "days" / "0.csv").stat().st_mtime_ns == before
    assert seen == [(1, 2), (2, 2)]
    assert not left.exists()
    assert contents(tmp_path) == contents(folder)


@pytest.mark.slow
def test_a_day_cut_short_is_done_again(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write, written = simulated.write_environment_map, []

    def fails_at_the_second(path: Path, sky: EnvironmentMap) -> None:
        if len(written) == 1:
            raise KeyboardInterrupt
        written.append(path)
        write(path, sky)

    monkeypatch.setattr(simulated, "write_environment_map", fails_at_the_second)
    with pytest.raises(KeyboardInterrupt):
        simulate(tmp_path)
    monkeypatch.undo()
    assert not (tmp_path / "index.csv").exists()
    assert not list((tmp_path / "days").iterdir())
    simulate(tmp_path, workers=2)
    assert contents(tmp_path) == contents(folder)


@pytest.mark.slow
def test_an_interrupt_ends_the_workers_and_keeps_whole_days(tmp_path: Path) -> None:
    """Ctrl-C reaches every process of a terminal, so it is sent to the group."""
    command = [sys.executable, "-m", "skylight", "skies", "simulate", "--days", "300"]
    options = ["--size", "8x32", "--interval", "400", "--workers", "2", "--out", str(tmp_path)]
    process = subprocess.Popen(
        [*command, *options],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # a shell's background job is started with the signal ignored, which a child inherits
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    )
    while process.poll() is None and not list(tmp_path.glob("days/[0-9]*.csv")):
        time.sleep(0.1)
    os.killpg(process.pid, signal.SIGINT)
    try:
        error = process.communicate(timeout=200)[1]
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        raise
    assert process.returncode == 1
    assert error.startswith("skylight: interrupted")
    assert error.count("\n") == 1
    # no worker is left in the group; the tracker of spawned processes goes a moment after them
    for _ in range(100):
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            break
        time.sleep(0.1)
    else:
        pytest.fail("a worker outlived the command by ten seconds")
    done = list(tmp_path.glob("days/*.csv"))
    assert 1 <= len(done) < 300
    assert not [p for p in tmp_path.rglob("*") if p.name.startswith(".partial")]
    assert not (tmp_path / "index.csv").exists()


@pytest.mark.slow
def test_simulating_leaves_the_callers_threads_alone(tmp_path: Path) -> None:
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        simulate(tmp_path, days=1)
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


def test_shares_of_regimes_belong_to_the_settings(tmp_path: Path) -> None:
    def run(**shares: float) -> Path:
        return simulate_folder(
            tmp_path,
            days=3,
            interval_min=600.0,
            height=8,
            shares=shares,  # type: ignore[arg-type]
        )

    run(overcast=1.0)
    assert {r.regime for r in read_index(tmp_path)} == {"overcast"}
    assert json.loads((tmp_path / "settings.json").read_text())["shares"] == {
        "clear": 0.0,
        "broken": 0.0,
        "overcast": 1.0,
    }
    with pytest.raises(InputError, match="made with other settings"):
        run(clear=1.0)
    (tmp_path / "settings.json").write_text("{")
    with pytest.raises(InputError, match=r"settings\.json: damaged"):
        run(overcast=1.0)


@pytest.mark.parametrize("first_seed", [-1, EVALUATION_SEEDS - 1, EVALUATION_SEEDS])
def test_seeds_for_evaluation_are_refused(tmp_path: Path, first_seed: int) -> None:
    with pytest.raises(InputError, match="29999999"):
        simulate_folder(tmp_path / "new", days=2, first_seed=first_seed)
    assert not (tmp_path / "new").exists()


def test_skies_on_the_spot_have_seeds_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    simulate_sky = simulated.simulate_sky
    monkeypatch.setattr(
        simulated, "simulate_sky", lambda *moment, height: simulate_sky(*moment, height=height // 4)
    )
    found = simulated_skies(2, first_seed=7, lowest_transmittance=0.5)
    assert all(r.sun_transmittance >= 0.5 for r, _ in found)
    assert all(r.seed is not None and r.seed >= EVALUATION_SEEDS + 7 for r, _ in found)
    assert len({r.day for r, _ in found}) == 2
    again = simulated_skies(1, first_seed=7, lowest_transmittance=0.5)
    assert torch.equal(found[0][1].radiance, again[0][1].radiance)
    with pytest.raises(InputError, match="at least 0"):
        simulated_skies(1, first_seed=-1)


def test_a_folder_grows(tmp_path: Path) -> None:
    """Days of another range join those that are there, in the index too."""
    for days, first in ((2, 0), (1, 2)):
        simulate_folder(tmp_path, days=days, first_seed=first, interval_min=400.0, height=8)
    assert {r.seed for r in read_index(tmp_path)} == {0, 1, 2}
    simulate_folder(tmp_path, days=1, interval_min=400.0, height=8)
    assert {r.seed for r in read_index(tmp_path)} == {0, 1, 2}
