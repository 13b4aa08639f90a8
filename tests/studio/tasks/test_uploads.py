"""Photographs and maps of light as they come in, and every way in which they are refused."""

import json
import re
import struct
import zlib
from contextlib import closing
from http.client import HTTPConnection
from io import BytesIO
from pathlib import Path

import httpx
import numpy as np
import pytest
import torch
from PIL import Image
from skimage.data import astronaut

from skylight.io._files import write_environment_map
from skylight.sphere._envmap import EnvironmentMap
from skylight.studio._state import PREFIX, clean_name
from skylight.studio.tasks._uploads import pixel_count
from tests.studio.conftest import PATIENCE_S, UPLOAD_MB, Served


def test_a_photograph_is_shown_with_its_face(client: httpx.Client, portrait: bytes) -> None:
    answer = client.post("/api/photos?name=C:\\pictures\\me.jpg", content=portrait)
    assert answer.status_code == 201
    told = answer.json()
    assert (told["name"], told["width"], told["height"]) == ("me.jpg", 512, 512)
    (face,) = told["faces"]
    x, y, width, height = face["box"]
    assert face["number"] == 1
    assert (180, 90) < (x + width / 2, y + height / 2) < (260, 170)  # where Eileen Collins' is
    assert 60 < width < 150
    preview = client.get(f"/api/photos/{told['photo']}/preview.jpg")
    assert preview.headers["content-type"] == "image/jpeg"
    shown = np.asarray(Image.open(BytesIO(preview.content)), dtype=float)
    assert np.abs(shown - astronaut()).mean() < 4


def test_a_large_photograph_has_a_smaller_preview(tmp_path: Path) -> None:
    from skylight.studio.tasks._uploads import see_photo

    tall = np.tile(np.pad(astronaut(), ((0, 0), (0, 88), (0, 0))), (4, 1, 1))
    Image.fromarray(tall).save(tmp_path / "p.png")
    seen = see_photo(
        str(tmp_path / "p.png"), "p", str(tmp_path / "s.jpg"), 10**7, tell=lambda *_: None
    )
    assert (seen["width"], seen["height"]) == (469, 1600)
    assert Image.open(tmp_path / "s.jpg").size == (469, 1600)
    assert [face["number"] for face in seen["faces"]] == [1, 2, 3, 4]
    centres = sorted(face["box"][1] / 400 for face in seen["faces"])
    assert np.allclose(np.diff(centres), 1, atol=0.03)  # one in each of four equal pictures


def test_a_photograph_cut_short_is_one_line(client: httpx.Client, portrait: bytes) -> None:
    answer = client.post("/api/photos?name=me.jpg", content=portrait[: len(portrait) // 2])
    assert answer.status_code == 422
    assert answer.json()["error"].startswith("me.jpg: damaged or cut short")


def test_too_large_uploads_are_refused_by_what_they_say(client: httpx.Client) -> None:
    host, port = client.base_url.host, client.base_url.port
    with closing(HTTPConnection(host, port, timeout=PATIENCE_S)) as connection:
        connection.putrequest("POST", "/api/photos")
        connection.putheader("Content-Length", str(int(UPLOAD_MB * 1e6) + 1))
        connection.endheaders()  # and not a byte of it
        answer = connection.getresponse()
        assert answer.status == 413
        assert "more than 1 MB" in json.load(answer)["error"]


@pytest.mark.skipif(not Path("/proc").exists(), reason="reads a process's memory in /proc")
def test_too_large_uploads_are_refused_by_what_comes(client: httpx.Client, served: Served) -> None:
    """Those that do not say how large they are; nothing of them is kept."""
    (folder,) = served.temporary.glob(f"{PREFIX}*")
    before = {file for file in folder.rglob("*") if file.is_file()}
    answer = client.post("/api/photos", content=(bytes(10**5) for _ in range(500)))
    assert answer.status_code == 413
    assert {file for file in folder.rglob("*") if file.is_file()} == before
    peak = re.search(r"VmHWM:\s+(\d+) kB", Path(f"/proc/{served.process.pid}/status").read_text())
    assert peak is not None
    assert int(peak[1]) < 150_000  # and it never had the 50 MB together


def test_headers_of_many_pixels_are_refused_before_any_is_decoded(client: httpx.Client) -> None:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    size = struct.pack(">IIBBBBB", 4000, 3000, 8, 2, 0, 0, 0)
    png = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", size) + chunk(b"IDAT", zlib.compress(b""))
    for name, content in {
        "a.png": png,
        "a.hdr": b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 3000 +X 4000\n",
        # as only the reader's parser has it, after what could be taken for a long header
        "b.hdr": b"#?RADIANCE\n" + b"#" * 70_000 + b"\n\n-Y 3000\t+X +4000\n",
    }.items():
        answer = client.post(f"/api/photos?name={name}", content=content)
        assert answer.status_code == 422
        assert f"{name}: 12 million pixels, 0.5 at most" in answer.json()["error"]


def test_pixels_by_header(tmp_path: Path) -> None:
    environment = EnvironmentMap(radiance=torch.ones(16, 32, 3))
    for name in ("a.exr", "a.hdr"):
        write_environment_map(tmp_path / name, environment)
        assert pixel_count(tmp_path / name) == 512
    Image.new("RGB", (7, 5)).save(tmp_path / "a.tif")
    assert pixel_count(tmp_path / "a.tif") == 35
    (tmp_path / "b.exr").write_bytes(b"\x76\x2f\x31\x01")
    assert pixel_count(tmp_path / "b.exr") is None


def test_maps(client: httpx.Client, tmp_path: Path) -> None:
    write_environment_map(tmp_path / "a.hdr", EnvironmentMap(radiance=torch.ones(32, 64, 3)))
    answer = client.post("/api/maps?name=sky.hdr", content=(tmp_path / "a.hdr").read_bytes())
    assert answer.status_code == 201
    told = answer.json()
    assert (told["name"], told["width"], told["height"]) == ("sky.hdr", 64, 32)
    write_environment_map(tmp_path / "b.exr", EnvironmentMap(radiance=torch.ones(16, 64, 3)))
    answer = client.post("/api/maps?name=half.exr", content=(tmp_path / "b.exr").read_bytes())
    assert answer.status_code == 422
    assert answer.json()["error"].startswith("half.exr: 64x16 is the upper half")


@pytest.mark.parametrize(
    ("told", "kept"),
    [
        ("me.jpg", "me.jpg"),
        ("/etc/passwd", "passwd"),
        ("..", ".."),
        ("a\r\nSet-Cookie: x.png", "aSet-Cookie: x.png"),
        ("", "photo"),
        ("x/", "photo"),
        ("é" * 500 + ".exr", "é" * 76 + ".exr"),
    ],
)
def test_names_are_for_people(told: str, kept: str) -> None:
    assert clean_name(told, "photo") == kept
