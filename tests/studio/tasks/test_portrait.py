"""A person taken apart: what is kept and sent, and what the page's own program makes of it."""

import asyncio
import base64
import dataclasses
import inspect
import json
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
from skylight.portrait._keys import KEYS, key_light
from skylight.portrait._relit import (
    BASE,
    HAIR_COUNTS,
    SOFT,
    Portrait,
    blurred,
    coarse_power,
    filled,
    light_in_photo,
    portrait_of,
    shared_light,
)
from skylight.sphere._envmap import LUMINANCE, EnvironmentMap
from skylight.sphere._frame import DirectionGrid
from skylight.studio._guard import Limits
from skylight.studio._jobs import Job, State
from skylight.studio._server import make_application
from skylight.studio._state import Studio, Upload
from skylight.studio.tasks._portrait import FACE_PX, command_of, packed, take_apart
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
    const { shading, glossy, ratio, common } = light.under(azimuth, zenith, strength, size);
    return { shading: coded(shading), glossy: coded(glossy), ratio: coded(ratio), common };
});
const told = JSON.stringify({ skin: light.skin, whole: light.whole, answers });
process.stdout.write(told, () => process.exit(0));
"""
# looked for before a person is rendered for them
needs_three = pytest.mark.skipif(
    not (STUDIO / "node_modules" / "three").is_dir(), reason="three.js is not installed"
)
# azimuth and elevation as who looks at the picture has them, strength, width in degrees
LIGHTS = (
    (-50.0, 30.0, 4.0, 15.0), (20.0, 60.0, 4.0, 40.0), (85.0, 10.0, 1.0, 25.0),
    (140.0, 35.0, 12.0, 15.0),
)  # fmt: skip


@lru_cache(maxsize=1)
def small() -> Portrait:
    """The portrait at the page's size."""
    kept = KeptFace.of(apart().result)
    return portrait_of(
        read_photo(apart().photo), kept.fit, kept.reflection, light_in_photo(kept), face_px=FACE_PX
    )


def by_the_page(lights: Sequence[tuple[float, float, float, float]]) -> dict[str, Any]:
    """What the page's program has of these lights."""
    keys = [(180 - azimuth, 90 - elevation, *more) for azimuth, elevation, *more in lights]
    file = base64.b64encode(apart().file.read_bytes()).decode()
    answer = run_in_node(_PROGRAM, {"file": file, "keys": keys})
    for one in answer["answers"]:
        for name, grid in (("shading", "skin"), ("glossy", "skin"), ("ratio", "whole")):
            values = np.frombuffer(base64.b64decode(one[name]), np.float32)
            one[name] = values.reshape(answer[grid]["height"], answer[grid]["width"], 3)
    return answer


def in_grid(
    image: Float[np.ndarray, "p q *c"], grid: dict[str, int]
) -> Float[np.ndarray, "h w *c"]:
    """The part of the shading's picture that a grid of pixels shows."""
    rows = slice(grid["top"], grid["top"] + grid["height"] * grid["step"])
    columns = slice(grid["left"], grid["left"] + grid["width"] * grid["step"])
    return image[rows, columns]


def balanced(
    portrait: Portrait, light: EnvironmentMap
) -> tuple[Float[np.ndarray, "p q 3"], Float[np.ndarray, "p q 3"]]:
    """S_B and g_B with the colour of skin's mean shading kept (``keep="place"``)."""
    shading, specular = portrait.shaded_by(light)
    received = shading[portrait.bare > 0].mean(0)
    gains = portrait.mean / received
    gains *= (received @ LUMINANCE) / ((gains * received) @ LUMINANCE)
    return gains * shading, gains * specular


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
    np.testing.assert_array_equal(bits, portrait.person.sight.visible.numpy())
    assert bits.shape[1] == len(DirectionGrid.latlong(32))
    codes = tensors["picture"][..., :3].numpy()
    np.testing.assert_array_equal(codes, taken_apart.codes)
    # a key light as bright as its fill is, by both numbers, as bright as the light found
    dimmed = facts["ball"] / (facts["fill"] * (1 + facts["metered"]))
    light = key_light(told.found.estimate, "right", strength=1.0).environment
    rest = dimmed * float(tensors["rest_power"].sum())
    added = float(coarse_power(light).sum()) - rest
    # the lamp's energy, whose irradiance on what faces it is less by its spread
    assert added == pytest.approx(dimmed * facts["fill"], rel=0.01)
    assert float(torch.tensor(facts["colour"]) @ torch.tensor(LUMINANCE)) == pytest.approx(1.0)


@needs_three
def test_shading_in_the_page_is_that_of_the_portrait() -> None:
    portrait = small()
    page = by_the_page(LIGHTS)
    bare = in_grid(portrait.bare, page["skin"]) > 0
    known = np.maximum(portrait.bare, HAIR_COUNTS * portrait.covered)
    base = BASE * float(portrait.mean @ np.array(LUMINANCE))
    for (*place, strength, size_deg), ours in zip(LIGHTS, page["answers"], strict=True):
        azimuth, elevation = place
        moved = key_light(
            apart().result.estimate, (azimuth, elevation), size_deg=size_deg, strength=strength
        ).environment
        shading, specular = balanced(portrait, moved)
        mean = shading[portrait.bare > 0].mean()
        want = in_grid(filled(shading, known), page["skin"])
        off = np.abs(ours["shading"] - want)
        assert off[bare].mean() < 0.01 * mean, (azimuth, elevation)
        want_specular = in_grid(filled(specular, known), page["skin"])
        off = np.abs(ours["glossy"] - want_specular)
        # a rougher lobe stands for a wider light
        assert off[bare].mean() < 0.1 * want_specular[bare].mean(), (azimuth, elevation)
        soft = blurred(shading, portrait.covered, SOFT * portrait.person.face_px)
        ratio = filled(np.log((soft + base) / (portrait.soft + base)), portrait.covered)
        coarse = in_grid(ratio, page["whole"])[::2, ::2]
        covered = in_grid(portrait.covered, page["whole"])[::2, ::2] > 0
        off = np.abs(ours["ratio"][: len(coarse), : coarse.shape[1]] - coarse)[covered]
        assert off.mean() < 0.02, (azimuth, elevation)  # a logarithm: 2 %
        assert np.abs(ratio).max() > 0.5
        assert ours["common"] == pytest.approx(shared_light(portrait.found, moved), abs=0.02)


def test_of_a_grey_photograph_the_light_is_grey(told: Told, taken_apart: TakenApart) -> None:
    portrait = dataclasses.replace(taken_apart.portrait, grey=True)
    tensors, facts = packed(portrait, KeptFace.of(told.found))
    assert len(set(facts["colour"])) == 1
    for name in ("rest_shading", "rest_glossy"):
        assert (tensors[name] == tensors[name][:, :1]).all()


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
