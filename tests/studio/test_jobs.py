"""Jobs from their request to their files: progress, limits, cancelling, and what they leave."""

import json
import math
import os
import signal
import time
import zipfile
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from skylight.io._files import read_environment_map
from skylight.studio._jobs import GONE_S
from tests.studio.conftest import JOBS, PATIENCE_S, STAGES, Served, begin, events, finished

MAPS = ["posterior.exr", "probe.exr", "probe.hdr", "probe.png"]
FILES = ["estimate.json", "mesh.obj", *MAPS, "report.png"]


def test_an_estimate_tells_how_far_it_is(estimated: list[dict[str, Any]]) -> None:
    stages = list(dict.fromkeys(each["stage"] for each in estimated if each["stage"]))
    # a server that is kept waiting passes over short ones
    assert [stage for stage in STAGES if stage in stages] == stages
    assert len(stages) > 1
    assert all("result" not in each for each in estimated[:-1])
    assert (estimated[-1]["state"], estimated[-1]["share"]) == ("done", 1.0)
    assert len({each["job"] for each in estimated}) == 1


def test_an_estimate_s_result(client: httpx.Client, estimated: list[dict[str, Any]]) -> None:
    last = estimated[-1]
    assert last == client.get(f"/api/jobs/{last['job']}").json()
    result = last["result"]
    assert result["sources"] == ["me.jpg"]
    assert result["light"] == "lamps"
    camera = result["camera"]
    assert (camera["width"], camera["height"], camera["principal"]) == (512, 512, [256, 256])
    # the head's middle is seen where the face is, which looks at the camera
    x, y, z = result["faces"][0]["eyes"]
    column = camera["principal"][0] - camera["focal_px"] * x / z
    row = camera["principal"][1] + camera["focal_px"] * y / z
    assert 180 < column < 280
    assert 60 < row < 180
    forward = result["faces"][0]["forward"]
    assert math.hypot(*forward) == pytest.approx(1)
    assert forward[2] > 0.8


def test_an_estimate_s_files(client: httpx.Client, estimated: list[dict[str, Any]]) -> None:
    last, job = estimated[-1], estimated[-1]["job"]
    assert [file["name"] for file in last["files"]] == FILES
    files = {name: client.get(f"/api/jobs/{job}/files/{name}") for name in FILES}
    assert [len(files[file["name"]].content) for file in last["files"]] == [
        file["size"] for file in last["files"]
    ]
    assert json.loads(files["estimate.json"].content).items() <= last["result"].items()
    saved = client.get(f"/api/jobs/{job}/files/probe.exr?download=1")
    assert saved.headers["content-disposition"] == 'attachment; filename="probe.exr"'
    assert files["probe.exr"].headers["content-disposition"].startswith("inline")
    packed = client.get(f"/api/jobs/{job}/files.zip?download=1")
    with zipfile.ZipFile(BytesIO(packed.content)) as archive:
        assert {name: archive.read(name) for name in archive.namelist()} == {
            name: answer.content for name, answer in files.items()
        }


@pytest.mark.slow
def test_an_estimate_made_again_is_equal(
    client: httpx.Client, photo: str, estimated: list[dict[str, Any]]
) -> None:
    again = finished(client, kind="estimate", photo=photo, light="lamps")
    assert _without_times(again["result"]) == _without_times(estimated[-1]["result"])


def test_the_light_of_an_estimate_is_coded(
    client: httpx.Client, estimated: list[dict[str, Any]]
) -> None:
    code = finished(client, kind="code", job=estimated[-1]["job"], dictionary="iso", activations=4)
    assert code["state"] == "done", code.get("error")
    assert code["result"]["counts"] == [1, 2, 3, 4]


def _without_times(result: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in result.items() if name not in ("seconds", "stats")}


@pytest.mark.parametrize("name", ["nothing.exr", "..%2f..%2fpreview.jpg", "%2e%2e", ""])
def test_files_are_those_of_the_list(
    client: httpx.Client, estimated: list[dict[str, Any]], name: str
) -> None:
    path = f"/api/jobs/{estimated[-1]['job']}/files/{name}"
    answer = client.get(httpx.URL(client.base_url, raw_path=path.encode()))
    assert answer.status_code == 404
    assert "error" in answer.json()


@pytest.mark.parametrize(
    "body", ["{", '{"kind": NaN}', "[" * 60_000, '{"kind":"voxel","face_mm":NaN}']
)
def test_wrong_json_is_one_line(client: httpx.Client, body: str) -> None:
    headers = {"Content-Type": "application/json"}
    answer = client.post("/api/jobs", content=body, headers=headers)
    assert answer.status_code in (400, 422)
    assert list(answer.json()) == ["error"]


@pytest.mark.skipif(not Path("/proc").exists(), reason="looks for processes in /proc")
def test_too_many_jobs_are_refused_and_cancelling_waits_for_no_work(
    client: httpx.Client, photo: str, served: Served
) -> None:
    first = begin(client, kind="estimate", photo=photo)
    stream = events(client, first)
    while next(stream)["stage"] in ("", *STAGES[: STAGES.index("tracing light")]):
        pass
    with served.held():  # also processes that help to trace
        waiting = [begin(client, kind="estimate", photo=photo) for _ in range(JOBS - 1)]
        answer = client.post("/api/jobs", json={"kind": "estimate", "photo": photo})
        assert answer.status_code == 429
        assert client.get(f"/api/jobs/{waiting[0]}").json()["state"] == "waiting"
        assert client.get(f"/api/jobs/{first}/files.zip").status_code == 409

        workers = set(served.workers())
        assert len(workers) == 2
        for job in waiting:
            assert client.delete(f"/api/jobs/{job}").status_code == 204
        start = time.monotonic()
        assert client.delete(f"/api/jobs/{first}").status_code == 204
        *_, told = stream
        assert told["state"] == "cancelled"
        while workers <= set(served.workers()):  # until the one that worked is gone
            assert time.monotonic() - start < PATIENCE_S
            time.sleep(0.01)
        (gone,) = workers - set(served.workers())
        while _group(gone):
            assert time.monotonic() - start < PATIENCE_S
    for job in (first, *waiting):
        assert client.get(f"/api/jobs/{job}").json()["state"] == "cancelled"
        assert client.delete(f"/api/jobs/{job}").status_code == 204  # now forgotten
        assert client.get(f"/api/jobs/{job}").status_code == 404
    # and the next one is worked on
    last = finished(client, kind="estimate", photo=photo, face=3)
    assert last["state"] == "failed"
    assert last["error"].startswith("me.jpg: there is no face 3")
    assert "result" not in last


def _group(leader: int) -> list[int]:
    """Processes that this one started, and they; those that only wait to be reaped left out."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            state, _, group = path.read_text().rpartition(")")[2].split()[:3]
            if int(group) == leader and state != "Z":
                found.append(int(path.parent.name))
    return found


def _ticks(pid: int) -> int:
    """Of the clock, that a process has worked."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return int(fields[11]) + int(fields[12])


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc").exists(), reason="looks for processes in /proc")
def test_a_worker_that_dies_takes_one_job_with_it(
    client: httpx.Client, photo: str, served: Served
) -> None:
    with served.held():  # so that both are there
        before = {pid: _ticks(pid) for pid in served.workers()}
    job = begin(client, kind="estimate", photo=photo)
    stream = events(client, job)
    while next(stream)["stage"] in ("", *STAGES[:2]):  # most of the work is still to come
        pass
    worker = max(before, key=lambda pid: _ticks(pid) - before[pid])  # the other one is idle
    os.kill(worker, signal.SIGKILL)
    *_, told = stream
    assert told["state"] == "failed"
    assert told["error"].startswith("the process that worked on it died")
    assert "no face 3" in finished(client, kind="estimate", photo=photo, face=3)["error"]


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc").exists(), reason="looks for processes in /proc")
def test_a_job_whose_page_went_is_cancelled(
    client: httpx.Client, photo: str, served: Served
) -> None:
    finished(client, kind="estimate", photo=photo, face=3)  # its worker has started
    with served.held():  # the job does not end by itself
        job = begin(client, kind="estimate", photo=photo)
        stream = events(client, job)
        while next(stream)["state"] != "running":
            pass
        stream.close()
        time.sleep(0.2 * GONE_S)
        back = events(client, job)
        assert next(back)["state"] == "running"  # a page that was loaded anew in between
        left = time.monotonic()
        back.close()
        while (state := client.get(f"/api/jobs/{job}").json()["state"]) == "running":
            assert time.monotonic() - left < PATIENCE_S
            time.sleep(0.1)
        assert state == "cancelled"
        assert time.monotonic() - left > 0.9 * GONE_S


def test_a_code_tells_of_each_activation(client: httpx.Client, tmp_path: Path) -> None:
    """Of a map that is one lobe of the dictionary."""
    import torch

    from skylight.io._files import write_environment_map
    from skylight.sphere._envmap import EnvironmentMap
    from skylight.sphere._frame import DirectionGrid, direction_from_angles

    looks = direction_from_angles(torch.tensor(0.6), torch.tensor(1.1))
    cosine = DirectionGrid.latlong(32).directions.float() @ looks
    lobe = torch.exp(12 * (cosine - 1)).reshape(32, 64, 1) * torch.tensor([3.0, 2.0, 1.0])
    write_environment_map(tmp_path / "lobe.exr", EnvironmentMap(radiance=lobe))
    content = (tmp_path / "lobe.exr").read_bytes()
    light = client.post("/api/maps?name=lobe.exr", content=content).json()["map"]
    last = finished(client, kind="code", map=light, dictionary="vmf", activations=6)
    assert last["state"] == "done", last.get("error")
    result = last["result"]
    assert result["errors"] == sorted(result["errors"], reverse=True)
    assert len(result["activations"]) == result["counts"][-1] <= 6
    first = result["activations"][0]
    assert first["azimuth_deg"] == pytest.approx(np.degrees(0.6), abs=6)
    assert first["zenith_deg"] == pytest.approx(np.degrees(1.1), abs=6)
    red, green, blue = first["weight"]
    assert (green / red, blue / red) == pytest.approx((2 / 3, 1 / 3), rel=1e-3)
    outline = np.array(first["outline"])
    assert np.abs(outline.mean(0) - [first["azimuth_deg"], first["zenith_deg"]]).max() < 4
    decoded = client.get(f"/api/jobs/{last['job']}/files/decoded.exr").content
    (tmp_path / "decoded.exr").write_bytes(decoded)
    away = read_environment_map(tmp_path / "decoded.exr").radiance - lobe
    assert float(away.norm() / lobe.norm()) == pytest.approx(result["errors"][-1], abs=0.03)


def test_a_photo_is_forgotten_with_what_works_on_it(
    client: httpx.Client, served: Served, portrait: bytes
) -> None:
    mine = client.post("/api/photos?name=mine.jpg", content=portrait).json()["photo"]
    with served.held():
        job = begin(client, kind="estimate", photo=mine)
        assert client.delete(f"/api/photos/{mine}").status_code == 204
        assert client.get(f"/api/jobs/{job}").json()["state"] == "cancelled"
    assert client.get(f"/api/photos/{mine}/preview.jpg").status_code == 404
    assert client.delete(f"/api/photos/{mine}").status_code == 404
    wanted = {"kind": "estimate", "photo": mine}
    assert client.post("/api/jobs", json=wanted).status_code == 404
