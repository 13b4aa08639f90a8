"""Virtual scenes by the command line: relight, live and export, on drawn pictures of a 6D probe."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from skylight.cli import main
from skylight.errors import InputError
from skylight.io._bounded import write_json
from skylight.probes.cameras._board import save_board
from skylight.probes.cameras._intrinsics import FLIP, save_intrinsics
from skylight.probes.cameras._pose import OPENCV_FROM_BOARD, project
from skylight.probes.cameras._response import Response
from skylight.probes.partitions._captured import ProbeCapture, save_capture
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions._probe import PartitionProbe
from skylight.probes.partitions._relight_files import ScenePlacement, captured_light
from skylight.probes.partitions.printed._assembly import PartitionAssembly
from skylight.probes.partitions.printed._solids import ProbeSizes
from skylight.sphere._rotation import RigidTransform
from tests.probes.cameras.scenes import picture_of_board
from tests.probes.partitions.boards import box
from tests.probes.partitions.pictures import looking_from, picture_of_faces
from tests.probes.voxel.test_use import BOARD, LENS, pose

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


def board_picture(where) -> np.ndarray:
    return picture_of_board(
        BOARD,
        LENS,
        FLIP @ where.rotation.numpy() @ OPENCV_FROM_BOARD.T,
        FLIP @ where.translation.numpy(),
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A photo of the board, a cube of 20 units, and the files of camera, board, probe, capture."""
    folder = tmp_path_factory.mktemp("scene")
    save_board(folder / "board.json", BOARD)
    save_intrinsics(folder / "camera.json", LENS)
    write_json(folder / "probe.json", standing().to_json())
    save_capture(folder / "capture.json", captured())
    Image.fromarray(board_picture(pose(30, 35))).save(folder / "photo.png")
    import trimesh

    cube = trimesh.Trimesh(box().vertices.numpy(), box().faces.numpy())
    cube.export(folder / "cube.ply")
    return folder


def command(folder: Path, verb: str, out: str, *more: str, names: tuple[str, ...]) -> list[str]:
    files = [part for name in names for part in (f"--{name}", str(folder / f"{name}.json"))]
    scene = ["--scene", str(folder / "cube.ply"), "--at-mm", "60", "0", "90", "--height-mm", "30"]
    quick = ["--rays", "32", "--bounces", "1", "--workers", "1", "--edge-mm", "10"]
    cache = ["--cache", str(folder / "cube.npz")]
    arguments = [*files, *scene, *quick, *cache, "--out", str(folder / out), *more]
    return ["probe", "partitions", verb, *arguments]


ALL = ("camera", "board", "probe", "capture")


def test_a_scene_is_put_into_a_photo(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photo = ["--photo", str(folder / "photo.png")]
    assert main(command(folder, "relight", "out.png", *photo, names=ALL)) == 0
    assert "in one place" not in capsys.readouterr().err
    written = (folder / "cube.npz").stat().st_mtime_ns
    assert main(command(folder, "relight", "again.png", *photo, names=ALL)) == 0
    assert (folder / "cube.npz").stat().st_mtime_ns == written  # coefficients are kept
    assert (folder / "out.png").read_bytes() == (folder / "again.png").read_bytes()
    before = np.asarray(Image.open(folder / "photo.png")).astype(float)
    after = np.asarray(Image.open(folder / "out.png")).astype(float)
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
        np.asarray(Image.open(folder / name)).astype(float)
        for name in ("still.png", "turned.png", "placed.png", "photo.png")
    )
    changed = (np.abs(expected - before) > 5).any(2)
    assert np.abs(turned - expected)[changed].mean() < 4
    assert np.abs(still - expected)[changed].mean() > 8


def test_what_cannot_be_done_is_said_in_a_line(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
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


def test_nothing_is_worked_out_for_what_is_outside(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> None:
        raise AssertionError("nothing is to be worked out")

    monkeypatch.setattr("skylight.probes.partitions._relight_files.read_probe", refused)
    arguments = command(folder, "relight", "a.png", "--photo", str(folder / "photo.png"), names=ALL)
    assert main([*arguments, "--at-mm", "9000", "0", "9000"]) == 2


def test_a_hidden_scene_is_not_said_to_be_outside(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
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
    assert main([*arguments, *there]) == 0
    assert "take care: the scene and the probe or its pole are in one place" in (
        capsys.readouterr().err
    )


def test_films_need_one_source_and_one_albedo(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    some = ("camera", "board", "probe")
    none = ["--video", str(folder / "none.mp4")]
    for more, names, told in [
        ([], some, "give --video or --webcam, and only one of them"),
        ([*none, "--webcam", "0"], some, "only one of them"),
        (none, some, "there is no such file; give a video"),
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
    import trimesh

    read = trimesh.load(folder / "cube.glb", force="mesh", process=False)
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
        return shading()[cells]

    for towards in ((1.0, 0.5, 0.1), (0.1, 0.5, 1.0), (0.2, 1.0, 0.3), (0.2, 0.9, 0.4)):
        where = looking_from(np.array(towards), MIDDLE - [0, 60.0, 0], 330.0)
        behind = response.linearise(board_picture(where)).numpy()
        light = picture_of_faces(placed, shine, LENS, where, behind)
        writer.write(cv2.cvtColor(response.encode(torch.from_numpy(light)), cv2.COLOR_RGB2BGR))
    writer.release()
    return film


def test_film_shows_the_scene_once_enough_cells_were_seen(
    folder: Path, film: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = command(
        folder, "live", "live.mp4", "--video", str(film), names=("camera", "board", "probe")
    )
    assert main(arguments) == 0
    told = capsys.readouterr().out
    assert "4 frames, 4 tracked" in told
    assert "3 of 6 cells" in told
    assert all(stage in told for stage in ("track", "capture", "relight", "draw"))
    made = cv2.VideoCapture(str(folder / "live.mp4"))
    plain = cv2.VideoCapture(str(film))
    frames = [(made.read()[1].astype(float), plain.read()[1].astype(float)) for _ in range(4)]
    # means of 8 x 8 pixels, which compression keeps
    changed = [
        (np.abs((a - b).reshape(60, 8, 80, 8, 3).mean((1, 3))).max(2) > 15).mean()
        for a, b in frames
    ]
    assert changed[0] == changed[1] == 0
    assert changed[3] > 0.005


def test_a_cube_turns_in_a_film(folder: Path, film: Path) -> None:
    """In the fourth of 25 frames a second it is at 30 degrees, some of them there from the start.

    It looks like a cube placed so; turned the other way round it would look like one at 0.
    """
    kept = {"still": "cube.npz", "placed": "placed.npz", "begun": "turns.npz"}
    last = {}
    for name, start, speed in (
        ("still", 0.0, 0.0),
        ("placed", 30.0, 0.0),
        ("begun", 15.0, 125.0),
    ):
        more = ["--video", str(film), "--turn-deg-per-s", str(speed)]
        more += ["--angles", "8"] if speed else []
        more += ["--turn-deg", str(start)]
        cache = ["--cache", str(folder / kept[name])]  # of the pictures above, if they were made
        names = ("camera", "board", "probe")
        assert main(command(folder, "live", f"{name}.mp4", *more, *cache, names=names)) == 0
        made = cv2.VideoCapture(str(folder / f"{name}.mp4"))
        last[name] = [made.read()[1].astype(float) for _ in range(4)][-1]
    plain = cv2.VideoCapture(str(film))
    before = [plain.read()[1].astype(float) for _ in range(4)][-1]
    changed = (np.abs(last["still"] - before) > 15).any(2)
    assert changed.mean() > 0.005
    wrong = np.abs(last["placed"] - last["still"])[changed].mean()
    assert wrong > 8
    assert np.abs(last["begun"] - last["placed"])[changed].mean() < 0.4 * wrong


def test_angles_without_a_turn_are_refused(
    folder: Path, film: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    more = ["--video", str(film), "--angles", "16"]
    names = ("camera", "board", "probe")
    assert main(command(folder, "live", "refused.mp4", *more, names=names)) == 2
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
