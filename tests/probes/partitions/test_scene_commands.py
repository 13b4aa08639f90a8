"""Virtual scenes by the command line: relight, live and export, on drawn pictures of a 6D probe."""

import io
import json
import sys
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals

from skylight.cli import main
from skylight.errors import InputError
from skylight.io._bounded import write_json
from skylight.probes.cameras._board import save_board
from skylight.probes.cameras._intrinsics import save_intrinsics
from skylight.probes.cameras._pose import project
from skylight.probes.cameras._response import Response
from skylight.probes.partitions._captured import ProbeCapture, save_capture
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions._probe import PartitionProbe
from skylight.probes.partitions._relight_files import ScenePlacement, captured_light
from skylight.probes.partitions.printed._assembly import PartitionAssembly
from skylight.probes.partitions.printed._solids import ProbeSizes
from skylight.sphere._rotation import RigidTransform
from tests.probes.partitions.boards import box
from tests.probes.partitions.pictures import board_seen, looking_from, picture_of_faces
from tests.probes.voxel.test_use import BOARD, LENS, pose

pytestmark = pytest.mark.usefixtures("coarse_ground")

DESIGN = named_design("6d")
CELLS = Cells.of(DESIGN)
MIDDLE = np.array([105.0, 150.0, 75.0])
ALBEDO = 0.8
# of the cells +x, -x, +y, -y, +z, -z
LIGHT = torch.tensor(
    [[0.9, 0.8, 0.6], [0.1, 0.1, 0.2], [0.5, 0.5, 0.6], [0.1, 0.1, 0.1], [0.3] * 3, [0.2] * 3],
    dtype=torch.float64,
)


def shading() -> torch.Tensor:
    return ALBEDO / np.pi * CELLS.facing[:, None] * LIGHT


def standing() -> PartitionAssembly:
    return PartitionAssembly(
        cells=CELLS,
        sizes=ProbeSizes(outer_mm=60.0, kernel_mm=9.0),
        board_from_probe=RigidTransform.translating(torch.from_numpy(MIDDLE)),
        pole_mm=(105.0, 75.0, 3.0, 125.0),
        board_mm=BOARD.size_mm,
        response=torch.diag(CELLS.facing),
    )


def captured() -> ProbeCapture:
    return replace(
        ProbeCapture.blank(DESIGN, torch.full((3,), ALBEDO, dtype=torch.float64)),
        shading=shading(),
        area_px=torch.full((6,), 50.0, dtype=torch.float64),
    )


def board_picture(where: RigidTransform) -> np.ndarray:
    return board_seen(BOARD, LENS, where)


@pytest.fixture(scope="module", autouse=True)
def built_once() -> Iterator[None]:
    """Every command here is about one printed probe."""
    placed = standing().placed()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PartitionAssembly, "placed", lambda _: placed)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A photo of the board, a cube of 20 units, and the files of camera, board, probe, capture."""
    folder = tmp_path_factory.mktemp("scene")
    save_board(folder / "board.json", BOARD)
    save_intrinsics(folder / "camera.json", LENS)
    write_json(folder / "probe.json", standing().to_json())
    save_capture(folder / "capture.json", captured())
    Image.fromarray(board_picture(pose(30, 35))).save(folder / "photo.png")
    trimesh.Trimesh(box().vertices.numpy(), box().faces.numpy()).export(folder / "cube.ply")
    return folder


def command(folder: Path, verb: str, out: str, *more: str, names: tuple[str, ...]) -> list[str]:
    files = [part for name in names for part in (f"--{name}", str(folder / f"{name}.json"))]
    scene = ["--scene", str(folder / "cube.ply"), "--at-mm", "60", "0", "90", "--height-mm", "30"]
    quick = ["--rays", "32", "--bounces", "1", "--workers", "1", "--edge-mm", "10"]
    cache = ["--cache", str(folder / "cube.npz")]
    arguments = [*files, *scene, *quick, *cache, "--out", str(folder / out), *more]
    return ["probe", "partitions", verb, *arguments]


ALL = ("camera", "board", "probe", "capture")
FILM = ("camera", "board", "probe")


def code_values(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path)).astype(float)


def test_a_scene_is_put_into_a_photo(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photo = ["--photo", str(folder / "photo.png")]
    assert main(command(folder, "relight", "out.png", *photo, names=ALL)) == 0
    assert "in one place" not in capsys.readouterr().err
    written = (folder / "cube.npz").stat().st_mtime_ns
    assert main(command(folder, "relight", "again.png", *photo, names=ALL)) == 0
    assert (folder / "cube.npz").stat().st_mtime_ns == written  # coefficients are kept
    assert (folder / "out.png").read_bytes() == (folder / "again.png").read_bytes()
    before, after = (code_values(folder / name) for name in ("photo.png", "out.png"))
    where = pose(30, 35)

    def at(picture: np.ndarray, *places: tuple[float, float, float]) -> np.ndarray:
        pixels = np.rint(project(np.array(places), where, LENS)).astype(int)
        return np.stack([picture[y - 1 : y + 2, x - 1 : x + 2].mean((0, 1)) for x, y in pixels])

    # the faces +y and +z, open to light that mostly comes from their own cells
    top, front = (
        Response()
        .linearise(
            np.rint(at(after, (60.0, 30.0, 90.0), (60.0, 22.0, 105.0))).astype(np.uint8)[None]
        )[0]
        .numpy()
    )
    probe = PartitionProbe(CELLS, ALBEDO).requires_grad_(False)
    share = CELLS.clamped_cosine(torch.tensor([[0.0, 1, 0], [0, 0, 1.0]]).double()) / np.pi
    expected = 0.7 * (share @ probe.light(shading()[None])[0]).numpy()
    np.testing.assert_allclose(top, expected[0], rtol=0.06)
    # the ground stands in for the cells below
    np.testing.assert_allclose(front, expected[1], rtol=0.3)
    # shadow on the board's margin and paper to the left, away from the light at +x
    left, right = (60.0 - 42, 0.0, 90.0), (60.0 + 90, 0.0, 90.0)
    ratio = (at(after, left) + 1) / (at(before, left) + 1)
    assert ratio.mean() < 0.97  # of codes, 0.93 of the light
    assert np.abs(at(after, right) - at(before, right)).max() < 8
    assert (after[:60] == before[:60]).all()


def test_any_turn_is_drawn_from_the_coefficients_of_a_few(folder: Path) -> None:
    """At 30 degrees, between two of eight angles, as when it is placed so; rays are cast once."""
    photo, kept = ["--photo", str(folder / "photo.png")], folder / "turns.npz"
    angles = [*photo, "--angles", "8", "--cache", str(kept)]
    assert main(command(folder, "relight", "still.png", *angles, names=ALL)) == 0
    written = kept.stat().st_mtime_ns
    turn = ["--turn-deg", "30"]
    assert main(command(folder, "relight", "turned.png", *angles, *turn, names=ALL)) == 0
    assert kept.stat().st_mtime_ns == written
    placed = [*photo, *turn, "--cache", str(folder / "placed.npz")]
    assert main(command(folder, "relight", "placed.png", *placed, names=ALL)) == 0
    still, turned, expected, before = (
        code_values(folder / name)
        for name in ("still.png", "turned.png", "placed.png", "photo.png")
    )
    changed = (np.abs(expected - before) > 5).any(2)
    assert np.abs(turned - expected)[changed].mean() < 4
    assert np.abs(still - expected)[changed].mean() > 8


def test_what_cannot_be_done_is_said_in_a_line(folder, capsys):
    photo = ["--photo", str(folder / "photo.png")]
    for out, more, told in [
        ("a.jpg", photo, ".png"),
        ("a.png", [*photo, "--at-mm", "9000", "0", "9000"], "outside of the picture"),
        ("a.png", [*photo, "--scale", "2"], "not both"),
        ("a.png", [*photo, "--at-mm", "60", "-5", "90"], "below the board"),
        ("a.png", [*photo, "--angles", "3"], "4 to 360 angles"),
        ("none/a.png", photo, "none/a.png: no such folder"),
        ("a.png", [*photo, "--cache", str(folder / "no" / "c.npz")], "c.npz: no such folder"),
        ("a.png", ["--photo", str(folder / "b.png"), "--scene", "no.obj"], "no.obj"),
    ]:
        assert main(command(folder, "relight", out, *more, names=ALL)) in (1, 2)
        error = capsys.readouterr().err.strip().splitlines()[-1]
        assert told in error


def test_nothing_is_worked_out_for_what_is_outside(folder, monkeypatch):
    def refused(*_: object) -> None:
        raise AssertionError("nothing is to be worked out")

    monkeypatch.setattr("skylight.probes.partitions._relight_files.read_probe", refused)
    arguments = command(folder, "relight", "a.png", "--photo", str(folder / "photo.png"), names=ALL)
    assert main([*arguments, "--at-mm", "9000", "0", "9000"]) == 2


def test_a_hidden_scene_is_not_said_to_be_outside(folder, capsys):
    """A speck within the kernel; and it is said that both are in one place."""
    inside = ["--at-mm", "105", "149.5", "75", "--height-mm", "1", "--cache"]
    arguments = command(folder, "relight", "a.png", "--photo", str(folder / "photo.png"), names=ALL)
    assert main([*arguments, *inside, str(folder / "speck.npz")]) == 2
    told = capsys.readouterr().err.strip().splitlines()[-1]
    assert "behind the probe" in told
    assert "outside" not in told


def test_scenes_in_the_probe_are_doubted(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = command(folder, "relight", "a.png", "--photo", str(folder / "photo.png"), names=ALL)
    there = ["--at-mm", "105", "0", "75", "--cache", str(folder / "pole.npz")]
    assert main([*arguments, *there, "--rays", "4", "--bounces", "0"]) == 0
    assert "take care: the scene and the probe or its pole are in one place" in (
        capsys.readouterr().err
    )


def test_films_need_one_source_and_one_albedo(folder, capsys):
    none = ["--video", str(folder / "none.mp4")]
    for more, names, told in [
        ([], FILM, "give --video or --webcam, and only one of them"),
        ([*none, "--webcam", "0"], FILM, "only one of them"),
        (none, FILM, "there is no such file; give a video"),
        ([*none, "--kernel-albedo", "0.7"], ALL, "without --kernel-albedo"),
    ]:
        assert main(command(folder, "live", "live.mp4", *more, names=names)) == 2
        assert told in capsys.readouterr().err


def test_light_that_no_cells_send_out_is_told() -> None:
    """A face that its neighbours' light must reach, and that is black."""
    facing = torch.diag(CELLS.facing)
    leak = torch.full((6, 6), 0.1, dtype=torch.float64) * float(CELLS.facing[0])
    probe = PartitionProbe(CELLS, ALBEDO, response=facing + leak)
    real = replace(standing(), response=probe.response)
    fair = ALBEDO / np.pi * (probe.response @ LIGHT)
    wrong = fair.clone()
    wrong[1] = 0.0
    warnings: list[str] = []
    light = captured_light(replace(captured(), shading=fair), real, probe, warnings.append)
    torch.testing.assert_close(light, LIGHT)
    assert not warnings
    light = captured_light(replace(captured(), shading=wrong), real, probe, warnings.append)
    assert bool((light >= 0).all())
    assert bool((probe.light(wrong[None]) < 0).any())
    assert "explained by no light of the cells" in warnings[0]


def test_export_has_the_same_light(folder: Path) -> None:
    arguments = command(folder, "export", "cube.glb", names=("probe", "capture"))
    assert main(arguments) == 0
    data = (folder / "cube.glb").read_bytes()
    length = int.from_bytes(data[12:16], "little")
    (mesh,) = json.loads(data[20 : 20 + length])["meshes"]
    np.testing.assert_allclose(mesh["extras"]["light"], LIGHT, atol=1e-9)
    read: Any = trimesh.load(folder / "cube.glb", force="mesh", process=False)
    # metres, standing on the origin
    np.testing.assert_allclose(read.bounds, [[-0.015, 0, -0.015], [0.015, 0.03, 0.015]], atol=1e-7)


@pytest.fixture(scope="module")
def film(folder: Path) -> Path:
    """Four frames that show more and more of the cells."""
    placed = standing().placed()
    film = folder / "film.avi"
    writer = cv2.VideoWriter(
        str(film), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (640, 480)
    )
    response = Response()

    def shine(cells: np.ndarray, points: np.ndarray) -> np.ndarray:
        return shading().numpy()[cells]

    for towards in ((1.0, 0.5, 0.1), (0.1, 0.5, 1.0), (0.2, 1.0, 0.3), (0.2, 0.9, 0.4)):
        where = looking_from(np.array(towards), MIDDLE - [0, 60.0, 0], 330.0)
        behind = response.linearise(board_picture(where)).numpy()
        light = picture_of_faces(placed, shine, LENS, where, behind)
        writer.write(cv2.cvtColor(response.encode(torch.from_numpy(light)), cv2.COLOR_RGB2BGR))
    writer.release()
    return film


def frames_of(film: Path) -> list[np.ndarray]:
    read = cv2.VideoCapture(str(film))
    return [read.read()[1].astype(float) for _ in range(4)]


@pytest.fixture(scope="module")
def live(folder: Path, film: Path) -> str:
    """live.mp4, of a scene that stands still; what was said."""
    with redirect_stdout(io.StringIO()) as said:
        assert main(command(folder, "live", "live.mp4", "--video", str(film), names=FILM)) == 0
    return said.getvalue()


def test_film_shows_the_scene_once_enough_cells_were_seen(folder, film, live):
    assert "4 frames, 4 tracked" in live
    assert "3 of 6 cells" in live
    assert all(stage in live for stage in ("track", "capture", "relight", "draw"))
    # means of 8 x 8 pixels, which compression keeps
    changed = [
        (np.abs((a - b).reshape(60, 8, 80, 8, 3).mean((1, 3))).max(2) > 15).mean()
        for a, b in zip(frames_of(folder / "live.mp4"), frames_of(film), strict=True)
    ]
    assert changed[0] == changed[1] == 0
    assert changed[3] > 0.005


@pytest.mark.usefixtures("live")
def test_a_cube_turns_in_a_film(folder: Path, film: Path) -> None:
    """In the fourth of 25 frames a second it is at 30 degrees, some of them there from the start.

    It looks like a cube placed so; turned the other way round it would look like one at 0.
    """
    for name, start, speed in (("placed", 30.0, 0.0), ("turns", 15.0, 125.0)):
        more = ["--video", str(film), "--turn-deg-per-s", str(speed), "--turn-deg", str(start)]
        more += ["--angles", "8"] if speed else []
        more += ["--cache", str(folder / f"{name}.npz")]  # of the pictures above, if they were made
        assert main(command(folder, "live", f"{name}.mp4", *more, names=FILM)) == 0
    still, placed, turned = (
        frames_of(folder / f"{name}.mp4")[-1] for name in ("live", "placed", "turns")
    )
    changed = (np.abs(still - frames_of(film)[-1]) > 15).any(2)
    assert changed.mean() > 0.005
    wrong = np.abs(placed - still)[changed].mean()
    assert wrong > 8
    assert np.abs(turned - placed)[changed].mean() < 0.4 * wrong


def test_angles_without_a_turn_are_refused(folder, capsys):
    more = ["--video", "film.avi", "--angles", "16"]
    assert main(command(folder, "live", "refused.mp4", *more, names=FILM)) == 2
    assert "give it with --turn-deg-per-s" in capsys.readouterr().err
    assert not (folder / "refused.mp4").exists()


def test_a_placement_says_how_large_and_where() -> None:
    cube = box(2.0)
    turned = ScenePlacement(x_mm=10.0, z_mm=20.0, y_mm=3.0, height_mm=8.0, turn_deg=90.0).placed(
        cube
    )
    torch.testing.assert_close(turned.vertices.amin(0), torch.tensor([6, 3, 16.0]).double())
    torch.testing.assert_close(turned.vertices.amax(0), torch.tensor([14, 11, 24.0]).double())
    # counter-clockwise from above: +X goes to -Z
    right = int((cube.vertices[:, 0] - cube.vertices[:, 1] - cube.vertices[:, 2]).argmax())
    assert float(turned.vertices[right, 2]) == pytest.approx(16)
    default = ScenePlacement(x_mm=0.0, z_mm=0.0).placed(cube)
    assert float(default.vertices[:, 1].max()) == pytest.approx(60)
    with pytest.raises(InputError, match="not both"):
        ScenePlacement(x_mm=0.0, z_mm=0.0, height_mm=1.0, scale=1.0)


def test_export_of_texels_has_the_light_of_the_faces(folder, capsys):
    pytest.importorskip("xatlas")
    arguments = command(folder, "export", "t.glb", "--atlas-px", "48", names=("probe", "capture"))
    arguments[arguments.index("--cache") + 1] = str(folder / "texels.npz")
    assert main(arguments) == 0
    assert "no texture coordinates" in capsys.readouterr().out
    with np.load(folder / "t.atlas.npz") as content:
        transfer, facts = content["transfer"].astype(float), json.loads(str(content["extras"]))
    radiance = np.einsum("nhwc,nc->hwc", transfer, facts["light"])
    read: Any = trimesh.load(folder / "t.glb", force="mesh", process=False)
    np.testing.assert_allclose(read.bounds, [[-0.015, 0, -0.015], [0.015, 0.03, 0.015]], atol=1e-7)
    share = CELLS.clamped_cosine(torch.tensor([[0.0, 1, 0]]).double()) / np.pi
    expected = 0.7 * (share @ LIGHT).numpy()
    uv = read.visual.uv[read.faces].mean(1)
    column, row = (uv[:, 0] * 48).astype(int), ((1 - uv[:, 1]) * 48).astype(int)
    top = np.isclose(read.vertices[read.faces][:, :, 1], 0.03).all(1)
    assert top.sum() >= 2
    found = radiance[row[top], column[top]]
    # nothing hides what the upper face sees
    np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), rtol=2e-3)
    written = (folder / "texels.npz").stat().st_mtime_ns
    assert main(arguments) == 0
    assert (folder / "texels.npz").stat().st_mtime_ns == written


def test_layouts_that_cannot_be_used_are_made_anew_or_said(folder, capsys, monkeypatch):
    """A sheet with one picture on both of its faces."""
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    twice = np.concatenate([square, square + np.array([0, 0, 0.2])])
    visual = TextureVisuals(
        uv=np.concatenate([square[:, :2]] * 2), image=Image.new("RGB", (4, 4), (200, 100, 50))
    )
    faces = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]
    trimesh.Trimesh(twice, faces, visual=visual, process=False).export(folder / "sheet.glb")
    arguments = command(folder, "export", "s.glb", "--atlas-px", "32", names=("probe", "capture"))
    arguments[arguments.index("--scene") + 1] = str(folder / "sheet.glb")
    arguments[arguments.index("--cache") + 1] = str(folder / "sheet.npz")
    monkeypatch.setitem(sys.modules, "xatlas", None)
    assert main(arguments) == 1
    told = capsys.readouterr()
    assert "coordinates overlap: 992 texels of 32 x 32" in told.out  # not on the diagonal
    assert "pip install 'skylight-lighting[atlas]'" in told.err.strip().splitlines()[-1]
    assert not (folder / "s.glb").exists()
    arguments[arguments.index("--atlas-px") + 1] = "2"
    assert main(arguments) == 2
    assert "4 texels" in capsys.readouterr().err.strip().splitlines()[-1]
    monkeypatch.undo()
    pytest.importorskip("xatlas")
    arguments[arguments.index("--atlas-px") + 1] = "32"
    assert main(arguments) == 0
    assert (folder / "s.atlas.npz").exists()
