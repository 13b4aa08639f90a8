"""``skylight export viewer``: what the page holds, what stays out of it, and what is refused."""

import base64
import hashlib
import json
import math
import re
import shutil
import struct
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from html.parser import HTMLParser
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image
from scipy.spatial import KDTree
from torch import Tensor

from skylight.cli import main
from skylight.io._files import write_environment_map
from skylight.maps._viewer import PAGE_BYTES_MAX
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid
from tests.estimated import MAKER, rewrite


@pytest.fixture(scope="module")
def made(estimated_portrait: tuple[Path, Path]) -> Path:
    """The folder of an estimate, beside its photograph portrait.jpg."""
    return estimated_portrait[1]


@pytest.fixture
def estimate(made: Path, tmp_path: Path) -> Path:
    """A copy to change."""
    return Path(shutil.copytree(made, tmp_path / "light"))


class Page(HTMLParser):
    """The elements of a page, and the text of those that browsers do not parse."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: dict[str, str] = {}
        self.within = ""
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = dict(attrs)
        self.tags.append((tag, named))
        self.within = tag if tag == "style" else str(named.get("type") or "")

    def handle_endtag(self, tag: str) -> None:
        self.within = ""

    def handle_data(self, data: str) -> None:
        if self.within:
            self.texts[self.within] = self.texts.get(self.within, "") + data

    @property
    def data(self) -> dict[str, Any]:
        return json.loads(self.texts["application/json"])


def export(estimate: Path, *options: object) -> Page:
    out = estimate.parent / "page.html"
    assert main(["export", "viewer", str(estimate), "--out", str(out), *map(str, options)]) == 0
    return Page(out)


def refused(estimate: Path, *options: object, out: str = "page.html", code: int = 2) -> str:
    """The one line of a command that fails; what was at its place stays there."""
    place = estimate.parent / out
    if out == "page.html":
        place.write_text("as it was")
    before = sorted(estimate.parent.iterdir())
    said, told = StringIO(), StringIO()
    with redirect_stderr(said), redirect_stdout(told):
        ended = main(["export", "viewer", str(estimate), "--out", str(place), *map(str, options)])
    assert (ended, told.getvalue()) == (code, "")
    assert sorted(estimate.parent.iterdir()) == before
    assert out != "page.html" or place.read_text() == "as it was"
    (line,) = said.getvalue().splitlines()
    assert line.startswith("skylight: ")
    return line


def decoded(stored: dict[str, Any]) -> EnvironmentMap:
    """Radiance's definition, in float64, beside the page's own decoder."""
    codes = np.frombuffer(base64.b64decode(stored["rgbe"]), np.uint8)
    codes = codes.reshape(stored["height"], stored["width"], 4).astype(np.float64)
    radiance = codes[..., :3] * 2.0 ** (codes[..., 3:] - 136)
    return EnvironmentMap(radiance=torch.from_numpy(radiance))


def sunny(rows: int) -> EnvironmentMap:
    """Noise of three orders of magnitude, and a sun of one pixel with most of the light."""
    noise = torch.rand(rows, 2 * rows, 3, generator=torch.Generator().manual_seed(0))
    radiance = 10 ** (3 * noise - 2)
    radiance[rows // 4, rows // 3] = torch.tensor([91_234.5, 80_123.4, 60_321.7])
    return EnvironmentMap(radiance=radiance)


def received(radiance: Tensor, light: EnvironmentMap, normals: Tensor) -> Tensor:
    """Irradiance by Lambert's law in float64, (normals, 3)."""
    cosines = (normals @ light.grid.directions.T).clamp(min=0) * light.grid.solid_angles
    return cosines @ radiance.double().reshape(-1, 3)


def differences(page: EnvironmentMap, true: EnvironmentMap) -> tuple[float, float]:
    """Largest differences of irradiance over that of each pixel's largest channel: (R, G, B; all
    normals), and the same of the whole sphere's integral."""
    most = true.radiance.amax(-1, keepdim=True).expand(-1, -1, 3)
    normals = DirectionGrid.hammersley(100).directions
    seen, known, largest = (
        received(radiance, true, normals) for radiance in (page.radiance, true.radiance, most)
    )
    whole = (page.integrate() - EnvironmentMap(radiance=true.radiance.double()).integrate()).abs()
    whole = whole / EnvironmentMap(radiance=most.double()).integrate()
    return float(((seen - known).abs() / largest).max()), float(whole.max())


@pytest.mark.parametrize("rows", [64, 128])
def test_the_probes_irradiance_is_in_the_page_to_a_256th(estimate: Path, rows: int) -> None:
    light = sunny(rows)
    write_environment_map(estimate / "probe.exr", light)
    stored = export(estimate).data["probe"]
    assert (stored["width"], stored["height"]) == (2 * rows, rows)
    worst, whole = differences(decoded(stored), light)
    assert 0 < worst <= 1 / 256  # it is rounded, but no more than is said
    assert whole <= 1 / 256


def test_a_larger_map_keeps_its_energy_and_moves_light_by_a_degree(estimate: Path) -> None:
    light = sunny(384)
    write_environment_map(estimate / "probe.exr", light)
    stored = export(estimate).data["probe"]
    assert (stored["width"], stored["height"]) == (256, 128)
    page = decoded(stored)
    most = float(light.radiance.amax(-1).reshape(-1) @ light.grid.solid_angles.float())
    assert abs(page.integrate() - light.integrate()).max() <= most / 256
    apart = max(
        float((page.irradiance(n) - light.irradiance(n)).abs().max())
        for n in DirectionGrid.hammersley(20).directions
    )
    assert apart <= (math.radians(1) + 1 / 256) * most


def test_a_sky_gets_a_dark_half(estimate: Path) -> None:
    write_environment_map(estimate / "probe.exr", EnvironmentMap(radiance=torch.ones(32, 128, 3)))
    page = decoded(export(estimate).data["probe"])
    assert page.layout == (64, 128)
    assert page.radiance[:32].min() == 1
    assert page.radiance[32:].max() == 0


def test_the_camera_is_that_of_the_picture_in_the_page(estimate: Path) -> None:
    data = export(estimate).data
    told = json.loads((estimate / "estimate.json").read_text(encoding="utf-8"))["faces"][0]
    picture = Image.open(BytesIO(base64.b64decode(data["photo"]["jpeg"])))
    camera = data["result"]["camera"]
    assert picture.size == (512, 512) == (camera["width"], camera["height"])
    assert camera["focal_px"] == pytest.approx(told["focal_length_px"])
    assert camera["principal"] == [256, 256]


def triangles(stored: dict[str, Any], eyes: list[float]) -> np.ndarray:
    """The corners of a head's triangles, (f, 3, 3), metres, as the page places them."""
    codes = np.frombuffer(base64.b64decode(stored["vertices"]), "<i2").reshape(-1, 3)
    faces = np.frombuffer(base64.b64decode(stored["faces"]), "<u2").reshape(-1, 3)
    return (np.array(eyes) + stored["scale"] * codes)[faces]


def test_the_head_is_that_of_the_mesh_to_micrometres(estimate: Path) -> None:
    data = export(estimate).data
    mesh = (estimate / "mesh.obj").read_text(encoding="utf-8")
    rows = [line.split() for line in mesh.splitlines()]
    vertices = np.array([row[1:] for row in rows if row[0] == "v"], dtype=float)
    faces = np.array([row[1:] for row in rows if row[0] == "f"], dtype=int) - 1
    (stored,), (face,) = data["heads"], data["result"]["faces"]
    head = triangles(stored, face["eyes"])
    want = vertices[faces]
    assert head.shape == want.shape
    # in whatever order: each triangle beside the one whose middle is nearest
    _, nearest = KDTree(want.mean(1)).query(head.mean(1))
    assert len(np.unique(nearest)) == len(want)
    turned = np.stack([np.roll(want[nearest], k, axis=1) for k in range(3)])
    assert np.abs(turned - head).max((2, 3)).min(0).max() < 6e-6
    # the head's own origin is within it, and the face looks out of it
    assert (head.min((0, 1)) < face["eyes"]).all()
    assert (face["eyes"] < head.max((0, 1))).all()
    assert np.linalg.norm(face["forward"]) == pytest.approx(1)
    assert all(0 < channel < 1 for channel in face["albedo"])


def test_the_photograph_may_come_in_another_size(estimate: Path, made: Path) -> None:
    full = export(estimate).data["result"]["camera"]
    with Image.open(made.parent / "portrait.jpg") as photo:
        photo.resize((2000, 2000)).save(estimate / "large.png")
    data = export(estimate, "--photo", estimate / "large.png").data
    assert data["photo"]["width"] == 1280
    assert data["result"]["camera"]["focal_px"] == pytest.approx(2.5 * full["focal_px"])
    assert data["name"] == "large.png"


def test_nothing_private_is_in_the_page(estimate: Path, made: Path) -> None:
    photo = str(made.parent / "portrait.jpg")
    told = json.loads((estimate / "estimate.json").read_text(encoding="utf-8"))
    assert told["taken"]["latitude_deg"] == pytest.approx(41.89)  # --keep-place
    assert told["sources"] == [photo]
    rewrite(estimate, advice=[f"left out: {photo}, face 2: too small"])
    page = export(estimate)
    jpeg = base64.b64decode(page.data["photo"]["jpeg"])
    assert b"Exif" not in jpeg
    assert not Image.open(BytesIO(jpeg)).getexif()
    assert b"Exif" in Path(photo).read_bytes()
    assert page.data["result"]["advice"] == ["left out: portrait.jpg, face 2: too small"]
    assert page.data["name"] == "portrait.jpg"
    text = page.texts["application/json"]
    for private in (str(made.parent), MAKER, "2024-06-01", "latitude", "heading", "taken"):
        assert private not in text, private


def test_no_text_becomes_markup(estimate: Path, made: Path) -> None:
    bad = "</script><script>alert(1)</script><!--<script>\u2028\"'&"
    name = "<img src=x onerror=alert(1)>.jpg"
    shutil.copy(made.parent / "portrait.jpg", estimate / name)
    plain = export(estimate)
    rewrite(estimate, advice=[bad], verdict={"light": bad}, light=bad)
    page = export(estimate, "--photo", estimate / name)
    assert page.tags == plain.tags
    assert page.data["result"]["advice"] == [bad]
    assert page.data["result"]["verdict"]["light"] == bad
    assert page.data["name"] == name
    assert "<" not in page.texts["application/json"]


def test_the_policy_lets_the_pages_own_script_run_alone(estimate: Path) -> None:
    page = export(estimate)
    (policy,) = [
        named["content"]
        for tag, named in page.tags
        if tag == "meta" and named.get("http-equiv") == "Content-Security-Policy"
    ]
    assert policy is not None
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    for rule, text in (("script-src", page.texts["module"]), ("style-src", page.texts["style"])):
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert rules[rule] == f"'sha256-{digest}'"
    sources = {part for rule in rules.values() for part in rule.split() if "'" not in part}
    assert sources == {"data:", "blob:"}
    assert [tag for tag, _ in page.tags if tag == "script"] == ["script"] * 2
    named = [(key, link) for _, each in page.tags for key, link in each.items()]
    links = [link for key, link in named if key in ("src", "href", "action", "srcset", "data")]
    assert links == ["data:,"]  # the icon, empty
    assert "url(" not in page.texts["style"]
    assert "@import" not in page.texts["style"]
    assert "three.js authors" in (estimate.parent / "page.html").read_text(encoding="utf-8")


def test_no_photograph_makes_the_page_too_large(
    estimate: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_environment_map(estimate / "probe.exr", sunny(128))
    rewrite(estimate, posterior={"is_seen": True})
    noise = np.random.default_rng(0).integers(0, 256, (1280, 1280, 3), dtype=np.uint8)
    Image.fromarray(noise).save(estimate / "noise.png")
    export(estimate, "--photo", estimate / "noise.png")
    size = (estimate.parent / "page.html").stat().st_size
    assert size < PAGE_BYTES_MAX
    assert f"{size / 1e6:.2f} MB" in capsys.readouterr().out


def test_of_several_pictures_one_is_shown(estimate: Path, made: Path) -> None:
    told = json.loads((estimate / "estimate.json").read_text(encoding="utf-8"))
    (face,) = told["faces"]
    other = {**face, "source": "far/b.jpg", "exposure": 3 * face["exposure"]}
    other |= {"eyes": [0.25, 0.0, -2.0], "white_balance": [2.0, 1.0, 0.5]}
    rewrite(estimate, faces=[face, other])
    (estimate / "mesh.obj").rename(estimate / "mesh_1.obj")
    trimesh.creation.box((0.2, 0.2, 0.2)).apply_translation((0.25, 0, -2)).export(
        estimate / "mesh_2.obj"
    )
    data = export(estimate).data
    assert data["name"] == "portrait.jpg"
    assert data["result"]["white_balance"] == pytest.approx(face["white_balance"])
    assert [head is None for head in data["heads"]] == [False, True]
    shutil.copy(made.parent / "portrait.jpg", estimate / "b.jpg")
    data = export(estimate, "--photo", estimate / "b.jpg").data
    # the map is in the first photograph's units, and this one was exposed longer
    assert data["result"]["white_balance"] == pytest.approx([6.0, 3.0, 1.5])
    assert data["heads"][0] is None
    assert len(data["result"]["faces"]) == 2
    corners = triangles(data["heads"][1], data["result"]["faces"][1]["eyes"])
    assert corners.min((0, 1)) == pytest.approx([0.15, -0.1, -2.1], abs=1e-5)
    assert corners.max((0, 1)) == pytest.approx([0.35, 0.1, -1.9], abs=1e-5)
    shutil.copy(made.parent / "portrait.jpg", estimate / "c.jpg")
    assert "portrait.jpg, b.jpg: name one" in refused(estimate, "--photo", estimate / "c.jpg")


# models


def box(folder: Path) -> Path:
    trimesh.creation.box((1, 1, 1)).export(folder / "box.glb")
    return folder / "box.glb"


@pytest.mark.parametrize("suffix", [".glb", ".obj"])
def test_a_model_goes_along(estimate: Path, suffix: str) -> None:
    path = estimate / f"box{suffix}"
    trimesh.creation.box((1, 1, 1)).export(path)
    stored = export(estimate, "--object", path).data["object"]
    assert stored["name"] == path.name
    assert base64.b64decode(stored["content"]) == path.read_bytes()


def with_scene(path: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    """A .glb with a changed scene, its lengths told as they are."""
    content = path.read_bytes()
    (size,) = struct.unpack_from("<I", content, 12)
    scene = json.loads(content[20 : 20 + size])
    change(scene)
    text = json.dumps(scene).encode()
    text += b" " * (-len(text) % 4)
    rest = content[20 + size :]
    head = struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A)
    path.write_bytes(head + text + rest)
    return path


def lying(place: int) -> Callable[[Path], Path]:
    def lie(folder: Path) -> Path:
        path = box(folder)
        content = bytearray(path.read_bytes())
        struct.pack_into("<I", content, place, 2**31)
        path.write_bytes(content)
        return path

    return lie


def many_accessors(folder: Path) -> Path:
    def claim(scene: dict[str, Any]) -> None:
        for accessor in scene["accessors"]:
            accessor["count"] = 2**40

    return with_scene(box(folder), claim)


def another_file(folder: Path) -> Path:
    away = {"uri": "https://example.org/x.bin", "byteLength": 4}
    return with_scene(box(folder), lambda scene: scene["buffers"].append(away))


def packed(folder: Path) -> Path:
    used = {"extensionsUsed": ["KHR_draco_mesh_compression"]}
    return with_scene(box(folder), lambda scene: scene.update(used))


def written(name: str, content: bytes) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        (folder / name).write_bytes(content)
        return folder / name

    return write


def heavy(folder: Path) -> Path:
    mesh = trimesh.creation.icosphere(subdivisions=6)
    mesh.export(folder / "ball.glb")
    assert 1_000_000 < (folder / "ball.glb").stat().st_size < 2_250_000
    return folder / "ball.glb"


def crowd(folder: Path) -> Path:
    """One mesh of 0.5 MB in many places."""
    trimesh.creation.icosphere(subdivisions=5).export(folder / "ball.glb")

    def place(scene: dict[str, Any]) -> None:
        (number,) = [k for k, node in enumerate(scene["nodes"]) if "mesh" in node]
        first = len(scene["nodes"])
        scene["nodes"] += [dict(scene["nodes"][number]) for _ in range(25)]
        scene["scenes"][0]["nodes"] += range(first, first + 25)

    return with_scene(folder / "ball.glb", place)


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (lying(8), "its header tells of 2147483648 bytes, it has"),
        (lying(12), "a part of it tells of 2147483648 bytes"),
        (many_accessors, "more than the file can hold"),
        (another_file, "it names other files"),
        (packed, "KHR_draco_mesh_compression: export it without compression"),
        (crowd, "more than the 500000 that the page draws"),
        (written("a.stl", b"solid"), "use .glb or .obj"),
        (written("a.glb", b"glTF"), "the page cannot hold it"),
        (written("a.glb", b""), "the page cannot hold it"),
        (written("a.obj", b"# nothing\n"), "no faces"),
        (written("a.obj", b"#" * 2_300_000), "more than the 2250000 that are read"),
        (lambda folder: folder / "none.glb", "No such file"),
        (lambda folder: folder, "use .glb or .obj"),
    ],
)
def test_models_that_cannot_be_shown(
    estimate: Path, model: Callable[[Path], Path], message: str
) -> None:
    path = model(estimate)
    line = refused(estimate, "--object", path)
    assert message in line
    assert str(path) in line


def test_a_model_that_makes_the_page_too_large(estimate: Path) -> None:
    path = heavy(estimate)
    noise = np.random.default_rng(0).integers(0, 256, (1280, 1280, 3), dtype=np.uint8)
    Image.fromarray(noise).save(estimate / "noise.png")
    line = refused(estimate, "--object", path, "--photo", estimate / "noise.png")
    (most,) = re.findall(r"ball.glb to ([\d.]+) MB", line)
    assert 0 < float(most) < path.stat().st_size / 1e6


# folders


def of_an_object(folder: Path) -> None:
    rewrite(folder, faces=[])


def with_face(**changed: Any) -> Callable[[Path], None]:
    """Other values of the face; None for what was not there in an earlier version."""

    def change(folder: Path) -> None:
        told = json.loads((folder / "estimate.json").read_text(encoding="utf-8"))
        face = told["faces"][0] | changed
        rewrite(folder, faces=[{k: v for k, v in face.items() if v is not None}])

    return change


def of_many_vertices(folder: Path) -> None:
    vertices = [f"v 0 {number} {number % 7}" for number in range(2**16 + 1)]
    faces = [f"f {first} {first + 1} {first + 2}" for first in range(1, 2**16)]
    (folder / "mesh.obj").write_text("\n".join(vertices + faces))


def without(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).unlink()


def holding(name: str, content: bytes) -> Callable[[Path], object]:
    return lambda folder: (folder / name).write_bytes(content)


def of_a_gigabyte(folder: Path) -> None:
    with (folder / "probe.exr").open("r+b") as stream:
        stream.truncate(2**30 + 2**20)


def with_nan(folder: Path) -> None:
    path = folder / "estimate.json"
    text = path.read_text(encoding="utf-8")
    path.write_text(re.sub(r'"region_radius_deg": [\d.]+', '"region_radius_deg": NaN', text))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (without("estimate.json"), "a folder that skylight estimate wrote"),
        (without("probe.exr"), "there is no such file"),
        (holding("estimate.json", b"{"), "not JSON"),
        (holding("estimate.json", b"[]"), '"light" is missing'),
        (holding("probe.exr", b"nothing"), "no OpenEXR file"),
        (of_an_object, '"faces" is empty'),
        (with_face(picture_px=None), '"picture_px" is missing; the page shows estimates of faces'),
        (with_face(forward=None), '"forward" is missing; the page shows estimates of faces'),
        (with_face(exposure=0.0), '"exposure" is not above 0'),
        (with_face(exposure=1e-300), '"exposure" is not above 0'),
        (with_face(focal_length_px=1e308), '"focal_length_px" is too large'),
        (without("mesh.obj"), "mesh.obj: there is no such file; estimate the photograph again"),
        (holding("mesh.obj", b"v 0 0 nothing"), "mesh.obj: not read as .obj"),
        (of_many_vertices, "mesh.obj: 65537 vertices are more than the 65536 of a head"),
        (of_a_gigabyte, "smaller by skylight convert --height 128"),
        (with_nan, "NaN is no number"),
        (lambda folder: rewrite(folder, advice="x"), '"advice" is no list'),
        (lambda folder: rewrite(folder, verdict={"doubt": 3}), '"doubt" is no text'),
        (lambda folder: rewrite(folder, sun=None), '"sun" is no object'),
    ],
)
def test_folders_that_hold_no_estimate(
    estimate: Path, spoil: Callable[[Path], object], message: str
) -> None:
    spoil(estimate)
    assert message in refused(estimate)


def test_photographs_that_do_not_fit(estimate: Path, made: Path) -> None:
    with Image.open(made.parent / "portrait.jpg") as photo:
        photo.crop((0, 0, 512, 400)).save(estimate / "cropped.png")
    line = refused(estimate, "--photo", estimate / "cropped.png")
    assert "512x400 pixels, and the picture of the estimate had 512x512" in line
    assert "none.jpg" in refused(estimate, "--photo", estimate / "none.jpg")
    told = json.loads((estimate / "estimate.json").read_text(encoding="utf-8"))
    rewrite(estimate, faces=[{**told["faces"][0], "source": "gone/away.jpg"}])
    assert "gone/away.jpg is not there; say where it is with --photo" in refused(estimate)
    for source, said in (("a" * 5000, "is not there"), ("a\n.jpg", '"source" is no file')):
        rewrite(estimate, faces=[{**told["faces"][0], "source": source}])
        assert said in refused(estimate)


def test_places_that_cannot_be_written_to(estimate: Path) -> None:
    (estimate.parent / "folder.html").mkdir()
    assert "no ordinary file" in refused(estimate, out="folder.html", code=1)
    assert "name it so" in refused(estimate, out="page.txt")
    assert "no such folder" in refused(estimate, out="nowhere/page.html", code=1)
    line = refused(estimate / "probe.exr")
    assert "a folder that skylight estimate wrote" in line
