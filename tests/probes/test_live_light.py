"""Live relighting finds the same light whether boards are followed or searched in every frame."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from skylight.probes._capture import LiveView
from skylight.probes.cameras._files import Setup
from skylight.probes.cameras._live import LiveFrame
from skylight.probes.cameras._pose import BoardPose, board_pose
from skylight.probes.cameras._response import Response
from skylight.probes.cameras._tracking import BoardTracker
from skylight.probes.partitions._captured import ProbeCapture
from skylight.probes.partitions._probe import PartitionProbe
from skylight.probes.partitions._relight_files import ScenePlacement, VirtualScene
from skylight.probes.partitions.relight._live import PartitionLiveView, RunningShading
from skylight.probes.partitions.relight._scene import Scene
from skylight.probes.partitions.relight._transfer import TransferSampling
from skylight.probes.voxel._assembly import PlacedProbe
from skylight.probes.voxel._model import star_probe
from skylight.probes.voxel._reconstruct import DirectReconstruction
from skylight.probes.voxel._relight import VoxelLiveView
from skylight.probes.voxel._render_files import VoxelPlacement
from tests.probes.partitions import test_scene_commands as partitions
from tests.probes.partitions.boards import box
from tests.probes.partitions.pictures import picture_of_faces
from tests.probes.voxel import test_use as voxel
from tests.probes.voxel.test_use import BOARD, LENS

# azimuth and elevation, 3 degrees from frame to frame, with two cuts
ORBIT = [(60.0, -12.0), (63.0, -12.0), (240.0, -12.0), (243.0, -12.0), (40.0, 35.0), (43.0, 35.0)]
Find = Callable[[np.ndarray], BoardPose | None]


def searched(_: BoardTracker, image: np.ndarray) -> BoardPose | None:
    """Every frame as a whole."""
    return board_pose(image, BOARD, LENS)


def shown(view: LiveView, film: list[np.ndarray]) -> list[LiveFrame]:
    frames = [view.show(image) for image in film]
    assert all(frame.tracked for frame in frames)
    return frames


def compared(followed: LiveFrame, searched: LiveFrame, photo: np.ndarray) -> None:
    """Codes where either has something drawn, but for outlines that are off by part of a pixel."""
    pictures = [each.picture.astype(float) for each in (followed, searched)]
    drawn = np.logical_or(*[(each != photo).any(2) for each in pictures])
    assert drawn.mean() > 0.005
    off = np.abs(pictures[0] - pictures[1]).max(2)[drawn]
    assert np.median(off) <= 2
    assert (off > 10).mean() < 0.1


def voxel_view() -> VoxelLiveView:
    return VoxelLiveView(
        Setup(intrinsics=LENS, board=BOARD, response=Response()),
        probe=PlacedProbe(voxel.standing()),
        model=star_probe(3),
        to_board=VoxelPlacement(x_mm=60.0, z_mm=75.0, voxel_mm=15.0).matrix(star_probe(3)),
        reconstruction=lambda lightmap: DirectReconstruction(lightmap.known),
    )


def voxel_film(views: list[tuple[float, float]]) -> list[np.ndarray]:
    return [voxel.photograph_from(voxel.pose(*view)) for view in views]


def partition_film(views: list[tuple[float, float]]) -> list[np.ndarray]:
    placed, shading, response = partitions.standing().placed(), partitions.shading(), Response()
    film = []
    for view in views:
        where = voxel.pose(*view)
        behind = response.linearise(partitions.board_picture(where)).numpy()
        light = picture_of_faces(
            placed, lambda cells, _: shading[cells].numpy(), LENS, where, behind
        )
        film.append(response.encode(torch.from_numpy(light)))
    return film


def partition_view(folder: Path, mesh: Scene, edge_mm: float) -> PartitionLiveView:
    """Of a mesh of 30 mm; what it needs is kept in the folder."""
    trimesh.Trimesh(mesh.vertices.numpy(), mesh.faces.numpy()).export(folder / "mesh.ply")
    scene = VirtualScene(
        mesh=folder / "mesh.ply",
        placement=ScenePlacement(x_mm=60.0, z_mm=90.0, height_mm=30.0),
        cache=folder / "mesh.npz",
        edge_mm=edge_mm,
        sampling=TransferSampling(rays=32, bounces=1),
    )
    assembly = partitions.standing()
    placed, albedo = assembly.placed(), torch.full((3,), partitions.ALBEDO).double()
    probe = PartitionProbe(partitions.CELLS, albedo, response=assembly.response)
    blank = ProbeCapture.blank(partitions.DESIGN, albedo)
    rotation = assembly.board_from_probe.rotation
    return PartitionLiveView(
        Setup(intrinsics=LENS, board=BOARD, response=Response()),
        placed=placed,
        probe=probe.requires_grad_(False),
        scene=scene.beside(placed, partitions.CELLS, rotation, pytest.fail),
        shading=RunningShading(blank.shading, blank.known),
    )


def test_of_the_voxel_probe(monkeypatch: pytest.MonkeyPatch) -> None:
    film = voxel_film(ORBIT)
    following, searching = voxel_view(), voxel_view()
    found = shown(following, film)
    monkeypatch.setattr(BoardTracker, "pose", searched)
    expected = shown(searching, film)
    true, light = voxel.light().radiance, [v.lightmap for v in (following, searching)]
    both = light[0].known & light[1].known
    assert both.sum() >= max(int(each.known.sum()) for each in light) - 1
    errors = [
        ((each.radiance - true)[both].mean((1, 2)).abs() / true[both].mean((1, 2))).median()
        for each in light
    ]
    assert errors[0] < 0.02
    assert errors[0] < errors[1] + 0.003
    compared(found[-1], expected[-1], film[-1])


def test_of_the_partition_probe(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    film, true = partition_film(ORBIT[2:]), partitions.shading()
    following, searching = (partition_view(tmp_path, box(), 10.0) for _ in range(2))
    found = shown(following, film)
    monkeypatch.setattr(BoardTracker, "pose", searched)
    expected = shown(searching, film)
    light = [view.shading for view in (following, searching)]
    assert torch.equal(light[0].known, light[1].known)
    known = light[0].known
    assert known.sum() >= 3
    off = [(each.shading - true)[known].abs().amax(1) / true[known].amax(1) for each in light]
    assert off[0].max() < 0.03
    assert off[0].max() < off[1].max() + 0.005
    compared(found[-1], expected[-1], film[-1])
