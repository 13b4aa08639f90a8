"""A person taken apart: what is kept and sent, and what the page's own program makes of it."""

import asyncio
import base64
import dataclasses
import inspect
import json
import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import torch
from jaxtyping import Float

from skylight.estimation._kept import KeptFace, read_face, warning_of
from skylight.faces._fit import FaceFit
from skylight.imaging._photo import read_photo
from skylight.io._tensors import read_tensors
from skylight.portrait._gain import level_of
from skylight.portrait._keys import KEYS, ball_weights, direction_seen, fill_of, key_light
from skylight.portrait._relit import (
    Portrait,
    coarse_power,
    light_in_photo,
    portrait_of,
    shared_light,
)
from skylight.portrait._surface import PersonSurface
from skylight.sphere._envmap import LUMINANCE, EnvironmentMap
from skylight.sphere._frame import DirectionGrid
from skylight.studio._guard import Limits
from skylight.studio._jobs import Job, State
from skylight.studio._server import make_application
from skylight.studio._state import Studio, Upload
from skylight.studio.tasks._portrait import _UNSEEN, command_of, take_apart
from tests.studio.conftest import finished
from tests.studio.tasks.conftest import TakenApart, Told
from tests.studio.tasks.taken_apart import PHOTO, apart
from tests.three_js import STUDIO, run_in_node

# vite reads TypeScript, as in the build
_PROGRAM = """
import { text } from "node:stream/consumers";
import { runnerImport } from "vite";
const options = { configFile: false, logLevel: "silent" };
const load = async (name) => (await runnerImport(`./src/face/relit/${name}.ts`, options)).module;
const { readPerson } = await load("person");
const { KeyLight } = await load("key_light");
const { file, keys } = JSON.parse(await text(process.stdin));
const light = new KeyLight(readPerson(Uint8Array.from(Buffer.from(file, "base64")).buffer));
const coded = ({ buffer, byteOffset, byteLength }) =>
    Buffer.from(buffer, byteOffset, byteLength).toString("base64");
const answers = keys.map(([azimuth, zenith, strength, size]) => {
    const { gain, hollow, typical, common, edge } = light.under(azimuth, zenith, strength, size);
    const { after, before } = hollow;
    return { gain: coded(gain), after: coded(after), before: coded(before), typical, common, edge };
});
const told = JSON.stringify({ grid: light.grid, answers });
process.stdout.write(told, () => process.exit(0));
"""
# looked for before a person is rendered for them
needs_three = pytest.mark.skipif(
    not (STUDIO / "node_modules" / "three").is_dir(), reason="three.js is not installed"
)
# azimuth and elevation as who looks at the picture has them, strength, width in degrees
LIGHTS = (
    (-50.0, 30.0, 4.0, 15.0), (20.0, 60.0, 4.0, 40.0), (85.0, 10.0, 1.0, 25.0),
    (140.0, 25.0, 12.0, 15.0), (105.0, 10.0, 4.0, 15.0),
)  # fmt: skip


@lru_cache(maxsize=1)
def small() -> Portrait:
    """The portrait at the page's size."""
    kept = KeptFace.of(apart().result)
    photo = read_photo(apart().photo)
    return portrait_of(photo, kept.fit, kept.reflection, light_in_photo(kept))


def by_the_page(lights: Sequence[tuple[float, float, float, float]]) -> dict[str, Any]:
    """What the page's program has of these lights."""
    keys = [(180 - azimuth, 90 - elevation, *more) for azimuth, elevation, *more in lights]
    file = base64.b64encode(apart().file.read_bytes()).decode()
    answer = run_in_node(_PROGRAM, {"file": file, "keys": keys})
    shape = answer["grid"]["height"], answer["grid"]["width"]
    for one in answer["answers"]:
        for name in ("gain", "after", "before"):
            one[name] = np.frombuffer(base64.b64decode(one[name]), np.float32).reshape(shape)
    return answer


def in_grid(image: Float[np.ndarray, "p q *c"], grid: dict[str, int]) -> np.ndarray:
    """The middle of each of a grid's cells of 2 x 2 pixels, where these lie in the picture."""
    top, left, step = grid["top"], grid["left"], grid["step"]
    part = image[top : top + step * grid["height"], left : left + step * grid["width"]]
    rows, columns = (step * (size // step) for size in part.shape[:2])
    part = part[:rows, :columns]
    return part.reshape(rows // step, step, columns // step, step, *part.shape[2:]).mean((1, 3))


def gain_of(portrait: Portrait, light: EnvironmentMap) -> Float[np.ndarray, "p q"]:
    """Changes of level on the face, as Portrait.under has them before it continues them."""
    shading, specular = portrait.shaded_by(light)
    hollow = portrait.bounced(shading)
    return level_of(shading, hollow, specular / portrait.albedo, portrait.on) - portrait.before


def test_what_is_kept_gives_the_portrait_of_the_estimate(told: Told) -> None:
    """A portrait is a function of fit, reflection and light found, and these are kept exactly.

    So no portrait need be compared: of equal numbers that lie elsewhere in memory a sum may be
    taken in another order, and the steep specular lobe amplifies its last bit a thousandfold.
    """
    want = KeptFace.of(told.found)
    kept = read_face(told.folder, want.photo)
    for field in dataclasses.fields(FaceFit):
        np.testing.assert_equal(getattr(kept.fit, field.name), getattr(want.fit, field.name))
    assert kept.reflection.head_error is not None
    assert want.reflection.head_error is not None
    assert torch.equal(kept.reflection.head_error, want.reflection.head_error)
    assert torch.equal(light_in_photo(kept).radiance, light_in_photo(want).radiance)
    for key in KEYS:
        light, same = (key_light(face, key).environment for face in (kept, want))
        assert torch.equal(light.radiance, same.radiance)
    assert kept.warning == warning_of(told.found.estimate)


def test_the_page_gets_points_and_bits_of_the_surface(told: Told, taken_apart: TakenApart) -> None:
    tensors, metadata = read_tensors(taken_apart.file)
    facts, portrait = json.loads(metadata["facts"]), taken_apart.portrait
    assert taken_apart.file.stat().st_size < 15e6
    left, top, width, height = facts["crop"]
    image = np.zeros((height, width, 3), np.float32)
    image.reshape(-1, 3)[tensors["places"]] = tensors["shading"]
    np.testing.assert_allclose(
        image, portrait.shading[top : top + height, left : left + width], rtol=1e-5, atol=1e-6
    )
    bits = np.unpackbits(tensors["visible"].numpy(), axis=1, bitorder="little")
    assert isinstance(portrait.person, PersonSurface)
    np.testing.assert_array_equal(bits, portrait.person.sight.visible.numpy())
    assert bits.shape[1] == len(DirectionGrid.latlong(32))
    codes = tensors["picture"][..., :3].numpy()
    np.testing.assert_array_equal(codes, taken_apart.codes)
    # a key light as bright as its fill is, by both numbers, as bright as the light found
    weight = float(ball_weights(direction_seen(*KEYS["right"])))
    dimmed = facts["ball"] / (facts["fill"] * (1 + weight))
    light = key_light(told.found.estimate, "right", strength=1.0).environment
    rest = (
        dimmed * facts["fill"] / math.pi * 4 * math.pi
    )  # an even light makes the ball pi as bright
    added = float(coarse_power(light).sum()) - rest
    # the lamp's energy, whose irradiance on what faces it is less by its spread
    assert added == pytest.approx(dimmed * facts["fill"], rel=0.02)


def test_the_page_gets_what_the_picture_does_not_show(taken_apart: TakenApart) -> None:
    tensors, _ = read_tensors(taken_apart.file)
    level = _UNSEEN * (tensors["marks"][..., 0].numpy() / 127.5 - 1)
    want = taken_apart.portrait.unseen.level.clip(-_UNSEEN, _UNSEEN)
    np.testing.assert_allclose(level, want, atol=_UNSEEN / 255 * 1.01)


def test_the_page_gets_what_room_the_picture_has(taken_apart: TakenApart) -> None:
    tensors, metadata = read_tensors(taken_apart.file)
    facts, portrait = json.loads(metadata["facts"]), taken_apart.portrait
    base = facts["darkest"] * (1 - tensors["marks"][..., 1].numpy() / 255)
    np.testing.assert_allclose(base, portrait.base, atol=-facts["darkest"] / 510 * 1.01)
    assert facts["veil"] == portrait.veil > 0


def test_the_fill_is_one_number_times_its_occlusion(taken_apart: TakenApart) -> None:
    tensors, metadata = read_tensors(taken_apart.file)
    facts, portrait = json.loads(metadata["facts"]), taken_apart.portrait
    shading, _ = portrait.shaded_by(fill_of(portrait.found))
    person = portrait.person
    want = shading[tuple(person.surface.pixels[person.skin].T.numpy())]
    ours = facts["fill"] * tensors["occlusion"].numpy()
    np.testing.assert_allclose(ours, want @ np.array(LUMINANCE), rtol=1e-3, atol=1e-6)


@needs_three
def test_gains_in_the_page_are_those_of_the_portrait() -> None:
    portrait = small()
    page = by_the_page(LIGHTS)
    covered = in_grid(portrait.on.traced, page["grid"]) == 1
    for (*place, strength, size_deg), ours in zip(LIGHTS, page["answers"], strict=True):
        azimuth, elevation = place
        moved = key_light(
            apart().result.estimate, (azimuth, elevation), size_deg=size_deg, strength=strength
        )
        gain = gain_of(portrait, moved.environment)
        want = in_grid(portrait.on.continued(gain), page["grid"])
        off = np.abs(ours["gain"][: len(want), : want.shape[1]] - want)[covered]
        assert off.mean() < 0.015, (azimuth, elevation)  # a logarithm: 1.5 %
        shading, _ = portrait.shaded_by(moved.environment)
        after = portrait.on.continued(portrait.on.share_of(portrait.bounced(shading), shading))
        for name, share in (("after", after), ("before", portrait.hollow_share)):
            want = in_grid(share, page["grid"])
            off = np.abs(ours[name][: len(want), : want.shape[1]] - want)[covered]
            assert off.mean() < 0.01 < want[covered].max() - want[covered].min()
        on_face = gain[portrait.on.face > 0]
        assert ours["typical"] == pytest.approx(float(on_face.mean()), abs=0.015)
        shared = shared_light(portrait.found, moved.environment)
        assert ours["common"] == pytest.approx(shared, abs=5e-3)
        edge = moved.edge
        assert ours["edge"]["strength"] == pytest.approx(edge.strength if edge else 0.0, abs=1e-6)
        if edge:
            assert ours["edge"]["spreadRad"] == pytest.approx(edge.spread_rad)
            np.testing.assert_allclose(ours["edge"]["direction"], edge.direction, atol=1e-6)
        else:
            assert np.ptp(on_face) > 0.5


def test_the_page_gets_the_outline_and_the_colours_of_skin(taken_apart: TakenApart) -> None:
    tensors, metadata = read_tensors(taken_apart.file)
    facts, portrait = json.loads(metadata["facts"]), taken_apart.portrait
    left, top, width, height = facts["crop"]
    crop = np.s_[top : top + height, left : left + width]
    want = np.dstack([portrait.outline.leaning, portrait.colour.alike, portrait.outline.around])[
        crop
    ]
    np.testing.assert_array_equal(tensors["outline"].numpy(), want)
    np.testing.assert_array_equal(tensors["share"].numpy(), portrait.on.share()[crop])
    pale = np.dstack([portrait.colour.pale, portrait.colour.astray])[crop]
    np.testing.assert_array_equal(tensors["pale"].numpy(), pale)
    np.testing.assert_allclose(facts["across"], portrait.colour.across, rtol=1e-6)
    assert np.abs(want[..., :2]).max() > 0.9
    np.testing.assert_allclose(facts["lacks"], portrait.colour.lacks, rtol=1e-6)
    assert len(facts["lacks"]) == 16  # as many as the page's program has room for


def test_the_command_line_names_what_was_chosen() -> None:
    told = command_of(PHOTO, "auto", 2, "my model")
    assert told["is_alone"]
    assert told["command"] == (
        "skylight relight-portrait 'someone'\"'\"'s photo.png' --light auto --face 2"
        " --model 'my model'"
    )
    own = command_of("me.png", "auto", 1, "own", "own:Mine")["command"]
    assert own.endswith("me.png --light auto --model own --network own:Mine")
    assert not command_of(PHOTO, "auto", "all", None)["is_alone"]
    there = command_of("me.png", "sphere", 1, None, place="indoors")["command"]
    assert there == "skylight relight-portrait me.png --light sphere --place indoors"


def test_a_portrait_is_asked_of_its_task(tmp_path: Path) -> None:
    """With the arguments that it takes, and no portrait of what is no estimate."""
    studio = Studio(tmp_path, Limits())
    folder = studio.photos.new_folder()
    photo = Upload(folder=folder, name="me.jpg", path=folder / "upload", seen={})
    studio.photos.add(photo)
    named: tuple[tuple[str, State], ...] = (
        ("estimate", "done"), ("estimate", "failed"), ("code", "done")
    )  # fmt: skip
    jobs = [
        Job(folder=folder, kind=kind, arguments={}, state=state, uses=(photo.id,))
        for kind, state in named
    ]
    for job in jobs:
        studio.jobs.kept.add(job)

    async def ask() -> list[int]:
        transport = httpx.ASGITransport(make_application(studio, host="127.0.0.1"))
        async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as client:
            wanted = [{"kind": "portrait", "job": job.id} for job in jobs]
            return [(await client.post("/api/jobs", json=one)).status_code for one in wanted]

    with ThreadPoolExecutor(1) as thread:  # the main one may hold the loop of the browser's driver
        assert thread.submit(asyncio.run, ask()).result() == [202, 409, 409]
    *_, begun = studio.jobs.kept
    told = inspect.signature(take_apart).bind(**begun.arguments, tell=lambda *_: None).arguments
    assert (told["path"], told["name"]) == (str(photo.path), "me.jpg")
    assert told["estimate"] == str(jobs[0].folder)
    assert begun.uses == (photo.id, jobs[0].id)


@pytest.mark.slow
def test_the_studio_takes_a_person_apart(
    client: httpx.Client, photo: str, estimated: list[dict[str, Any]]
) -> None:
    assert "person.safetensors" not in [file["name"] for file in estimated[-1]["files"]]
    done = finished(client, kind="portrait", job=estimated[-1]["job"])
    assert done["state"] == "done", done.get("error")
    assert [file["name"] for file in done["files"]] == ["portrait.safetensors"]
    # of a portrait there is no portrait, nor of an estimate that is not done
    failed = finished(client, kind="estimate", photo=photo, face=3)
    for job in (done, failed):
        answer = client.post("/api/jobs", json={"kind": "portrait", "job": job["job"]})
        assert answer.status_code == 409
        assert "name an estimate that is done" in answer.json()["error"]
