"""Lamps moved and switched: of a photograph's estimate, and asked of a running studio."""

import base64
import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import torch
from jaxtyping import UInt8
from PIL import Image
from skimage.data import astronaut

from skylight._figures import describe_lamps, white_of
from skylight.estimation._photos import estimate_photo
from skylight.estimation._report import over_grey
from skylight.estimation._summary import PhotoEstimate
from skylight.imaging._colour import tone_map
from skylight.imaging._edits import UNEDITED
from skylight.inverse._lamp_relighting import FaceTransport, LampLight, lamps_radiance
from skylight.inverse._result import Lamp
from skylight.inverse._scan import SCAN_HEIGHT
from skylight.io._files import read_environment_map
from skylight.models._lamps import AMBIENT_PARAMETERS, LampsLight
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import direction_from_angles
from skylight.studio.tasks._light import keep_lamps, light_edited
from tests.studio.conftest import STAGES, finished
from tests.studio.tasks.conftest import Told


@pytest.fixture(scope="module")
def found(told: Told) -> PhotoEstimate:
    assert told.found.estimate.lamps
    return told.found


@pytest.fixture(scope="module")
def folder(told: Told) -> Path:
    """Where its lamps are kept."""
    return told.folder


def test_each_stage_of_an_estimate_is_told(told: Told) -> None:
    assert tuple(told.stages) == STAGES
    assert all(shares == sorted(shares) for shares in told.stages.values())


def test_the_pages_table_has_ambient_light_and_widths(told: Told) -> None:
    facts, estimate = told.answer["lamp_facts"], told.found.estimate
    ambient = luminance(torch.tensor(facts["ambient_irradiance"]))
    assert float(ambient) == pytest.approx(torch.pi * estimate.exposure, rel=1e-5)
    spreads = [np.rad2deg(lamp.spread_rad) for lamp in estimate.lamps]
    # exactly so of narrow lamps
    assert facts["diameters_deg"] == pytest.approx([4 * spread for spread in spreads], rel=0.1)


def as_found(lamps: tuple[Lamp, ...]) -> dict[str, Any]:
    """An edit that changes nothing."""
    told = describe_lamps(lamps)
    return {
        "azimuth_deg": [one["azimuth_deg"] for one in told],
        "zenith_deg": [one["zenith_deg"] for one in told],
        "on": [True] * len(told),
        "ambient": True,
    }


def edited(folder: Path, file: str, edit: dict[str, Any]) -> bytes:
    answer = light_edited(str(folder), file, **edit, tell=lambda *_: None)
    return base64.b64decode(answer["content"])


def edited_map(folder: Path, edit: dict[str, Any], tmp_path: Path) -> EnvironmentMap:
    path = tmp_path / "map.exr"
    path.write_bytes(edited(folder, "probe.exr", edit))
    return read_environment_map(path)


def panels(folder: Path, edit: dict[str, Any]) -> UInt8[np.ndarray, "2 h w 3"]:
    """The face as photographed, and under the lamps."""
    with Image.open(io.BytesIO(edited(folder, "face.png", edit))) as picture:
        return np.stack(np.split(np.asarray(picture), 2, axis=1))


def test_an_edit_that_changes_nothing_gives_the_estimate(
    found: PhotoEstimate, folder: Path, tmp_path: Path
) -> None:
    edit, view = as_found(found.estimate.lamps), found.view
    again = edited_map(folder, edit, tmp_path)
    torch.testing.assert_close(
        again.radiance, found.estimate.environment.radiance, rtol=1e-4, atol=1e-6
    )
    seen, rendered = panels(folder, edit)
    white = white_of(view.observation.pixels)
    np.testing.assert_array_equal(seen, tone_map(view.image, white=white))
    want = over_grey(view.image, view.places, found.estimate.rendered[view.blocks])
    assert np.abs(rendered.astype(int) - tone_map(want, white=white).astype(int)).max() <= 1


def test_switched_off_lamps_leave_the_ambient_light(
    found: PhotoEstimate, folder: Path, tmp_path: Path
) -> None:
    edit = as_found(found.estimate.lamps)
    off = {**edit, "on": [False] * len(edit["on"])}
    params = found.estimate.params[:AMBIENT_PARAMETERS].double()
    want = found.estimate.exposure * LampsLight(0, 256).ambient(params)
    torch.testing.assert_close(
        edited_map(folder, off, tmp_path).flat.double(), want, rtol=1e-5, atol=0
    )
    dark = edited_map(folder, {**off, "ambient": False}, tmp_path)
    assert not bool(dark.radiance.any())
    faces = [panels(folder, one)[1].astype(int) for one in (edit, off, {**off, "ambient": False})]
    lit, ambient, black = faces
    rows, columns = found.view.places.unbind(1)
    assert not black[rows, columns].any()
    # normals are corrected to first order, so grazing ones may have negative transport: by what it
    # takes of the lamps' light pixels may get darker, others not at all
    estimate, view = found.estimate, found.view
    transport = FaceTransport.of(view.observation, estimate.faces[0], estimate.exposure)
    received = transport.diffuse @ lamps_radiance(estimate.lamps, SCAN_HEIGHT).float()
    taken = transport.gains * transport.pixel_albedo * received.clamp(max=0)
    plain = replace(transport, edit=UNEDITED)
    scene = plain.rendered(replace(LampLight.of(estimate), lamps=())) + taken
    floor = transport.edit.apply(scene)
    white = white_of(view.observation.pixels)
    codes = tone_map(floor[view.blocks][None], white=white)[0].astype(int)
    gained = (received > 0).all(1)[view.blocks].numpy()
    assert gained.mean() > 0.99
    assert (lit >= ambient)[rows, columns][gained].all()
    # a saturated picture shows less blue where warm light is added
    assert (lit[rows, columns] >= codes - 1).all()
    assert lit[rows, columns].mean() > ambient[rows, columns].mean() + 5


def test_a_moved_lamp_keeps_its_irradiance(
    found: PhotoEstimate, folder: Path, tmp_path: Path
) -> None:
    edit, lamp = as_found(found.estimate.lamps), found.estimate.lamps[0]
    count = len(edit["on"])
    alone = {**edit, "on": [True] + [False] * (count - 1), "ambient": False}
    for azimuth_deg, zenith_deg in ((-70.0, 35.0), (160.0, 120.0)):
        moved = {
            **alone,
            "azimuth_deg": [azimuth_deg] * count,
            "zenith_deg": [zenith_deg] * count,
        }
        towards = torch.tensor([azimuth_deg, zenith_deg], dtype=torch.float64).deg2rad()
        received = edited_map(folder, moved, tmp_path).irradiance(direction_from_angles(*towards))
        torch.testing.assert_close(received.double(), lamp.irradiance.double(), rtol=1e-2, atol=0)


@pytest.mark.slow
def test_several_faces_are_seen_below_each_other(tmp_path: Path) -> None:
    """Each as the estimate re-renders it, though less of its transport is kept."""
    two = np.concatenate([astronaut()[:400, :400], astronaut()[:400, 399::-1]], 1)
    result = estimate_photo(two, light="lamps", face="all", workers=1)
    assert len(result.seen) == 2
    assert result.estimate.lamps
    keep_lamps(tmp_path, result, LampLight.of(result.estimate))
    seen, rendered = panels(tmp_path, as_found(result.estimate.lamps))
    assert seen.shape == rendered.shape
    top = 0
    for one, light in zip(result.seen, result.estimate.faces, strict=True):
        view = one.view
        white = white_of(view.observation.pixels)
        want = tone_map(
            over_grey(view.image, view.places, light.rendered[view.blocks]), white=white
        )
        part = rendered[top : top + len(want), : want.shape[1]]
        assert np.abs(part.astype(int) - want.astype(int)).max() <= 1
        top += len(want)
    assert top == len(rendered)


@pytest.fixture(scope="module")
def job(estimated: list[dict[str, Any]]) -> dict[str, Any]:
    """An estimate of the studio."""
    return estimated[-1]


def asked(client: httpx.Client, job: dict[str, Any], name: str, **changes: Any) -> httpx.Response:
    """A file under the lamps as found but for these changes; those of None are left out."""
    lamps = job["result"]["lamps"]
    edit = {
        "azimuth_deg": [lamp["azimuth_deg"] for lamp in lamps],
        "zenith_deg": [lamp["zenith_deg"] for lamp in lamps],
        "on": ["true" for _ in lamps],
        "ambient": "true",
        **changes,
    }
    told = {key: value for key, value in edit.items() if value is not None}
    return client.get(f"/api/jobs/{job['job']}/lamps/{name}", params=told)


def test_the_studio_gives_its_own_map_and_files_to_keep(
    client: httpx.Client, job: dict[str, Any], tmp_path: Path
) -> None:
    facts = job["result"]["lamp_facts"]
    assert len(facts["diameters_deg"]) == len(job["result"]["lamps"])
    assert "lamps.safetensors" not in [file["name"] for file in job["files"]]
    own = client.get(f"/api/jobs/{job['job']}/files/probe.exr").content
    (tmp_path / "own.exr").write_bytes(own)
    (tmp_path / "again.exr").write_bytes(asked(client, job, "probe.exr").content)
    again, first = (read_environment_map(tmp_path / f"{name}.exr") for name in ("again", "own"))
    torch.testing.assert_close(again.radiance, first.radiance, rtol=1e-4, atol=1e-6)
    kept = asked(client, job, "probe.hdr", download="true", ambient="false")
    assert kept.headers["content-disposition"] == 'attachment; filename="edited_probe.hdr"'
    assert kept.content.startswith(b"#?RADIANCE")
    face = asked(client, job, "face.png")
    assert (face.status_code, face.headers["content-type"]) == (200, "image/png")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"azimuth_deg": []}, "azimuth_deg: Field required"),
        ({"zenith_deg": [0.0] * 9}, "for each lamp"),
        ({"zenith_deg": [181.0]}, "zenith_deg.0: Input should be less than or equal to 180"),
        ({"azimuth_deg": ["nan"]}, "azimuth_deg.0: Input should be"),
        ({"on": ["perhaps"]}, "on.0: Input should be a valid boolean"),
        ({"ambient": None}, "ambient: Field required"),
        ({"folder": "/etc"}, "folder: Extra inputs"),
    ],
)
def test_wrong_edits_are_one_line(
    client: httpx.Client, job: dict[str, Any], changes: dict[str, Any], words: str
) -> None:
    answer = asked(client, job, "probe.exr", **changes)
    assert answer.status_code == 422
    error = answer.json()["error"]
    assert words in error
    assert "\n" not in error


def test_other_files_and_jobs_without_lamps_are_refused(
    client: httpx.Client, photo: str, job: dict[str, Any]
) -> None:
    assert asked(client, job, "mesh.obj").status_code == 422
    failed = finished(client, kind="estimate", photo=photo, face=3)
    answer = asked(client, {**job, "job": failed["job"]}, "face.png")
    assert answer.status_code == 409
    assert "no lamps to move" in answer.json()["error"]
