"""A voxel probe's use by the command line: capture, render and live, on drawn pictures."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation

from skylight.cli import main
from skylight.errors import InputError
from skylight.io._bounded import write_json
from skylight.probes.cameras._board import Board, save_board
from skylight.probes.cameras._drawing import composite, lens_rays, looking_at
from skylight.probes.cameras._intrinsics import FLIP, Intrinsics, save_intrinsics
from skylight.probes.cameras._pose import OPENCV_FROM_BOARD
from skylight.probes.cameras._response import Response
from skylight.probes.voxel._assembly import VoxelAssembly
from skylight.probes.voxel._lightmap import Lightmap, load_lightmap
from skylight.probes.voxel._model import exposed_faces, star_probe, visibility_vectors, write_voxels
from skylight.probes.voxel._relight import VoxelRenderer
from skylight.probes.voxel._render_files import VoxelPlacement, render_voxels
from skylight.sphere._rotation import RigidTransform
from tests.probes.cameras.scenes import picture_of_board

BOARD = Board(columns=7, rows=5, square_mm=30.0, marker_mm=22.0)
LENS = Intrinsics(width=640, height=480, fx=560.0, fy=560.0, cx=322.0, cy=238.0, k1=-0.08)
MIDDLE = np.array([105.0, 150.0, 75.0])
VIEWS = [(a, 35.0) for a in range(20, 380, 60)] + [(a, -12.0) for a in range(0, 360, 60)]


def light() -> Lightmap:
    """Light whose parts neighbours alone shadow, so that every slot can be told from five."""
    generator = torch.Generator().manual_seed(2)
    parts = 0.02 + 0.16 * torch.rand(6, 5, 1, 1, 3, generator=generator)
    radiance = torch.einsum("ci,oixyk->ocxyk", visibility_vectors().float(), parts)
    radiance = radiance.expand(-1, -1, 16, 16, -1).contiguous()
    return Lightmap(radiance=radiance, coverage=torch.ones(6, 32), confidence=torch.ones(6, 32))


def standing() -> VoxelAssembly:
    return VoxelAssembly(
        model=star_probe(3),
        voxel_mm=20.0,
        board_from_probe=RigidTransform.translating(torch.from_numpy(MIDDLE - 30.0)),
        pole_mm=(105.0, 75.0, 3.0, 120.0),
    )


def pose(azimuth_deg: float, elevation_deg: float) -> RigidTransform:
    a, e = np.radians(azimuth_deg), np.radians(elevation_deg)
    towards = np.array([np.cos(e) * np.sin(a), np.sin(e), np.cos(e) * np.cos(a)])
    target = torch.from_numpy(MIDDLE - np.array([0, 55.0, 0]))
    return looking_at(torch.from_numpy(MIDDLE + 330 * towards), target)


@cache
def renderer() -> VoxelRenderer:
    matrix = standing().board_from_probe.matrix()
    cells = torch.diag(torch.tensor([20.0, 20, 20, 1], dtype=torch.float64))
    return VoxelRenderer(star_probe(3), matrix @ cells)


def photograph(number: int, brightness: float = 1.0) -> np.ndarray:
    return photograph_from(pose(*VIEWS[number]), brightness)


def photograph_from(where: RigidTransform, brightness: float = 1.0) -> np.ndarray:
    image = picture_of_board(
        BOARD,
        LENS,
        FLIP @ where.rotation.numpy() @ OPENCV_FROM_BOARD.T,
        FLIP @ where.translation.numpy(),
    )
    shown = replace(light(), radiance=light().radiance * brightness)
    window = renderer().window(where, LENS)
    drawing = renderer().draw(shown, lens_rays(LENS, 2, window), where)
    return composite(image, drawing, Response(), window)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pictures all round, and the files of camera, board and probe."""
    folder = tmp_path_factory.mktemp("probe")
    save_board(folder / "board.json", BOARD)
    save_intrinsics(folder / "camera.json", LENS)
    write_json(folder / "assembly.json", standing().to_json())
    for number in range(len(VIEWS)):
        Image.fromarray(photograph(number)).save(folder / f"photo_{number:02d}.png")
    return folder


def files(folder: Path, *, assembly: bool = True) -> list[str]:
    names = ["camera", "board", *(["assembly"] if assembly else [])]
    return [part for name in names for part in (f"--{name}", str(folder / f"{name}.json"))]


def photos(folder: Path, numbers: range = range(len(VIEWS))) -> list[str]:
    return [str(folder / f"photo_{number:02d}.png") for number in numbers]


@pytest.fixture(scope="module")
def captured(folder: Path) -> Path:
    out = folder / "capture"
    command = ["probe", "voxel", "capture", *photos(folder), *files(folder), "--out", str(out)]
    assert main(command) == 0
    return out


def test_capture_tells_the_light_of_each_slot(captured: Path) -> None:
    found = load_lightmap(captured / "lightmap.npz")
    faces = exposed_faces(star_probe(3))
    # the pole takes the face that looks down, which no other face is like
    assert int(found.known.sum()) == 29
    assert not found.known[3, 0]
    assert found.known[faces.orientation, faces.configuration].sum() == 29
    error = (found.radiance - light().radiance)[found.known].mean((1, 2))
    relative = error.abs() / light().radiance[found.known].mean((1, 2))
    assert float(relative.median()) < 0.02
    report = json.loads((captured / "capture.json").read_text())
    assert report["slots"] == 29
    assert len(report["pictures"]) >= 10
    assert report["disagreement"] < 0.03
    assert report["alignment"]["applied"]
    assert np.linalg.norm(report["alignment"]["shift_mm"]) < 0.4
    assert any("orientation -y has 4" in line for line in report["warnings"])
    assert Image.open(captured / "lightmap.png").size == (256, 192)


def test_a_capture_is_continued(folder: Path, tmp_path: Path) -> None:
    first = ["probe", "voxel", "capture", *photos(folder, range(2)), *files(folder)]
    assert main([*first, "--out", str(tmp_path / "c")]) == 0
    few = int(load_lightmap(tmp_path / "c" / "lightmap.npz").known.sum())
    more = ["probe", "voxel", "capture", *photos(folder, range(2, 5)), *files(folder)]
    assert main([*more, "--out", str(tmp_path / "c")]) == 2  # not by accident
    assert main([*more, "--out", str(tmp_path / "c"), "--more"]) == 0
    assert int(load_lightmap(tmp_path / "c" / "lightmap.npz").known.sum()) > few


@pytest.mark.parametrize("kind", ["direct", "global"])
def test_a_model_is_drawn_into_a_photo(
    folder: Path, captured: Path, tmp_path: Path, kind: str
) -> None:
    """The probe itself as the model, where it stands, in a photo without it."""
    write_voxels(tmp_path / "cross.npy", star_probe(3))
    out = tmp_path / "drawn.png"
    Image.fromarray(photograph(0, brightness=0.0)).save(tmp_path / "black.png")
    place = ["--at-mm", "105", "120", "75", "--voxel-mm", "20"]
    command = ["probe", "voxel", "render", str(tmp_path / "cross.npy"), "--reconstruction", kind]
    command += ["--lightmap", str(captured / "lightmap.npz"), "--out", str(out)]
    command += ["--photo", str(tmp_path / "black.png"), *files(folder, assembly=False), *place]
    assert main(command) == 0
    drawn = np.asarray(Image.open(out)).astype(int)
    photo = np.asarray(Image.open(folder / "photo_00.png")).astype(int)
    black = np.asarray(Image.open(tmp_path / "black.png")).astype(int)
    probe = np.abs(photo - black).max(-1) > 20
    assert 0.01 < probe.mean() < 0.2
    off = np.abs(drawn - photo).max(-1)
    # but for the outline, where a finer pixel mean falls on black
    assert (off[probe] > 8).mean() < 0.12
    assert np.median(off[probe]) <= 3
    assert (off[~probe] > 8).mean() < 0.003


def test_a_model_stands_parallel_to_a_turned_probe(captured: Path) -> None:
    """Light is known for the probe's six orientations: those the model's faces get."""
    turn = torch.from_numpy(Rotation.from_rotvec([0, 30, 0], degrees=True).as_matrix())
    placement = VoxelPlacement(x_mm=10.0, y_mm=5.0, z_mm=20.0, voxel_mm=2.0)
    matrix = placement.matrix(star_probe(3), turn)
    torch.testing.assert_close(matrix[:3, :3], 2 * turn)
    base = matrix @ torch.tensor([1.5, 0, 1.5, 1.0], dtype=torch.float64)
    torch.testing.assert_close(base[:3], torch.tensor([10.0, 5.0, 20.0], dtype=torch.float64))
    found = load_lightmap(captured / "lightmap.npz").rotation
    torch.testing.assert_close(found, torch.eye(3, dtype=torch.float64), atol=0.004, rtol=0)


def test_a_glb_turns_with_the_model(captured: Path, tmp_path: Path) -> None:
    bar = np.ones((1, 4, 1), bool)
    np.save(tmp_path / "bar.npy", bar)
    command = ["probe", "voxel", "render", str(tmp_path / "bar.npy"), "--rotate", "x1"]
    command += ["--lightmap", str(captured / "lightmap.npz"), "--out", str(tmp_path / "a.glb")]
    assert main(command) == 0
    mesh = trimesh.load(tmp_path / "a.glb", force="mesh")
    # 5 mm a voxel, in metres; +Y turned about +X is +Z
    np.testing.assert_allclose(mesh.extents, [0.005, 0.005, 0.02], atol=1e-6)


def test_a_film_gets_the_model_as_soon_as_all_sides_were_seen(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    film = tmp_path / "film.avi"
    writer = cv2.VideoWriter(
        str(film), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (640, 480)
    )
    numbers = [*range(len(VIEWS)), 0]
    for number in numbers:
        writer.write(cv2.imread(str(folder / f"photo_{number:02d}.png")))
    writer.release()
    write_voxels(tmp_path / "cross.npy", star_probe(3))
    command = ["probe", "voxel", "live", str(tmp_path / "cross.npy"), "--video", str(film)]
    command += [*files(folder), "--out", str(tmp_path / "live.mp4")]
    assert main([*command, "--at-mm", "60", "0", "75", "--voxel-mm", "15"]) == 0
    told = capsys.readouterr().out
    assert "13 frames" in told
    assert "frames/s (ms: track" in told
    made = cv2.VideoCapture(str(tmp_path / "live.mp4"))
    assert made.get(cv2.CAP_PROP_FPS) == pytest.approx(25)
    frames = []
    while True:
        there, frame = made.read()
        if not there:
            break
        frames.append(frame.astype(int))
    assert len(frames) == 13
    # the same view without the model at first and with it at last
    assert (np.abs(frames[0] - frames[12]).max(-1) > 40).mean() > 0.005


def test_a_probe_that_was_turned_on_its_pole_is_found(folder: Path, tmp_path: Path) -> None:
    """The assembly says 4 degrees less than the pictures show, and 1 mm too far right."""
    vector = torch.tensor([0, np.radians(-4.0), 0, 1.0, 0, 0], dtype=torch.float64)
    motion = RigidTransform.from_vector(vector).about(torch.from_numpy(MIDDLE))
    wrong = replace(standing(), board_from_probe=motion @ standing().board_from_probe)
    write_json(tmp_path / "assembly.json", wrong.to_json())
    command = ["probe", "voxel", "capture", *photos(folder), *files(folder, assembly=False)]
    command += ["--assembly", str(tmp_path / "assembly.json"), "--out", str(tmp_path / "c")]
    assert main(command) == 0
    told = json.loads((tmp_path / "c" / "capture.json").read_text())["alignment"]
    assert told["applied"]
    np.testing.assert_allclose(told["turn_deg"], [0, 4, 0], atol=0.25)
    np.testing.assert_allclose(told["shift_mm"], [-1, 0, 0], atol=0.4)
    found = load_lightmap(tmp_path / "c" / "lightmap.npz")
    error = (found.radiance - light().radiance)[found.known].mean((1, 2)).abs()
    relative = error / light().radiance[found.known].mean((1, 2))
    assert float(relative.median()) < 0.02


class TestRefusals:
    def test_no_board_in_view(
        self, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        Image.new("RGB", (640, 480), (90, 90, 90)).save(tmp_path / "grey.png")
        command = ["probe", "voxel", "capture", str(tmp_path / "grey.png"), *files(folder)]
        assert main([*command, "--out", str(tmp_path / "c")]) == 2
        assert "no marker board in view" in capsys.readouterr().err
        assert not (tmp_path / "c").exists()

    def test_a_board_of_another_size_is_refused(
        self, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        probe = replace(standing(), board_mm=(175.0, 125.0))
        write_json(tmp_path / "assembly.json", probe.to_json())
        command = ["probe", "voxel", "capture", *photos(folder), *files(folder, assembly=False)]
        command += ["--assembly", str(tmp_path / "assembly.json"), "--out", str(tmp_path / "c")]
        assert main(command) == 2
        assert "stands on a board of 175 x 125 mm" in capsys.readouterr().err

    def test_light_that_changed_before_a_capture_goes_on_is_said(
        self, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        command = ["probe", "voxel", "capture", *files(folder), "--out", str(tmp_path / "c")]
        assert main([*command, *photos(folder, range(1))]) == 0
        Image.fromarray(photograph(0, brightness=0.5)).save(tmp_path / "dim.png")
        assert main([*command, str(tmp_path / "dim.png"), "--more"]) == 0
        assert "the light moved or changed" in capsys.readouterr().err

    def test_over_exposure_is_refused(
        self, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        Image.fromarray(photograph(0, brightness=50.0)).save(tmp_path / "burnt.png")
        command = ["probe", "voxel", "capture", str(tmp_path / "burnt.png"), *files(folder)]
        assert main([*command, "--out", str(tmp_path / "c")]) == 2
        assert "over-exposed: expose shorter" in capsys.readouterr().err

    def test_few_sides_cannot_light_a_model(
        self, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        command = ["probe", "voxel", "capture", *photos(folder, range(1)), *files(folder)]
        assert main([*command, "--out", str(tmp_path / "c")]) == 0
        assert "walk round the probe" in capsys.readouterr().err
        write_voxels(tmp_path / "cross.npy", star_probe(3))
        command = ["probe", "voxel", "render", str(tmp_path / "cross.npy"), "--lightmap"]
        command += [str(tmp_path / "c" / "lightmap.npz"), "--out", str(tmp_path / "a.glb")]
        assert main(command) == 2
        assert "capture those sides" in capsys.readouterr().err

    def test_a_probe_that_encodes_too_little(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["probe", "voxel", "inspect", "--probe", "1"]) == 0
        assert "encodes too little" in capsys.readouterr().err

    def test_a_glb_has_no_use_for_a_photo(self, captured: Path, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="no use for one"):
            render_voxels(
                tmp_path / "x.npy",
                captured / "lightmap.npz",
                tmp_path / "x.glb",
                placement=VoxelPlacement(x_mm=0.0, z_mm=0.0),
                photo=tmp_path / "x.png",
            )

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (["--out", "x.obj"], "write a .glb"),
            (["--out", "x.png"], "needs a photo"),
            (["--out", "x.glb", "--rotate", "yy"], "such as y1"),
            (["--out", "x.glb", "--rotate", "w1"], "choose x, y or z"),
            (["--out", "x.glb", "--rotate", "y--1"], "such as y1"),
            (["--out", "x.glb", "--at-mm", "nan", "0", "0"], "finite mm"),
            (["--out", "x.glb", "--voxel-mm", "inf"], "finite mm"),
            (["--out", "x.glb", "--albedo", "0"], "albedo must be above 0"),
        ],
    )
    def test_renders_that_make_no_sense(
        self,
        captured: Path,
        tmp_path: Path,
        capsys: pytest.CaptureFixture[str],
        arguments: list[str],
        message: str,
    ) -> None:
        write_voxels(tmp_path / "cross.npy", star_probe(3))
        command = ["probe", "voxel", "render", str(tmp_path / "cross.npy")]
        command += ["--lightmap", str(captured / "lightmap.npz"), *arguments]
        assert main(command) == 2
        assert message in capsys.readouterr().err
