"""Where the time of a frame goes in live relighting, with both shading probes.

    DRJIT_LIBLLVM_PATH=... python -m tools.measure_live --data DIR --work DIR

Mitsuba renders a film of 640 x 480 of each printed probe on its pole over the board (extra
``render``): once round below the probe and once above, 3 degrees from frame to frame of the 240 by
default, 90 degrees a second. Films of an earlier run are used again. `probe voxel live` draws a
bunny of voxels into one, `probe partitions live` a cow with its shadow into the other, both on one
thread. Poses of boards that are followed are compared with the true ones, beside those of boards
that are searched in every frame.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import torch

from skylight.io._files import read_environment_map
from skylight.probes.cameras._files import Setup
from skylight.probes.cameras._live import LiveReport, film
from skylight.probes.cameras._pose import BoardPose, board_pose
from skylight.probes.cameras._response import Response
from skylight.probes.cameras._tracking import BoardTracker
from skylight.probes.partitions._relight_files import VirtualScene, live_scene
from skylight.probes.voxel._capture_files import live_film
from skylight.probes.voxel._model import voxelise
from tools import measure_partition_end_to_end as partitions, measure_voxel_end_to_end as voxel
from tools.measured import write_measured
from tools.rendered_photos import ALBEDO, BOARD, LENS, Photographer, halved

_EDGE_MM = 2.0
Find = Callable[[np.ndarray], BoardPose | None]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="with folders hdr and meshes")
    parser.add_argument("--map", default="abandoned_games_room_02.exr")
    parser.add_argument("--samples", type=int, default=48)
    parser.add_argument("--frames", type=int, default=240)
    parser.add_argument("--work", type=Path, required=True, help="folder for the films")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/live.json"))
    arguments = parser.parse_args()
    begun = time.time()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    facts: dict[str, object] = {}
    for name, measured in (("voxel", of_voxels), ("partitions", of_partitions)):
        facts[name], facts[f"{name}_poses"] = measured(arguments)
    write_measured(
        arguments.out,
        name="live",
        what="live relighting of 640 x 480 pixels in films rendered by Mitsuba, on one thread: "
        "medians by the clock and of the processor's time",
        command=f"python -m tools.measure_live --data {arguments.data.name} --work DIR",
        begun=begun,
        facts={"processor": processor(), "samples": arguments.samples, **facts},
    )


def of_voxels(arguments: argparse.Namespace) -> tuple[dict[str, object], dict[str, object]]:
    """Of `probe voxel live`."""
    environment = read_environment_map(arguments.data / "hdr" / arguments.map).resize(128)
    work = arguments.work / "voxel"
    stands = voxel.Standing(environment, arguments.map, arguments.samples, work)
    shot = stands.photographer.film(arguments.frames)
    report = live_film(
        shot,
        work / "live.mp4",
        setup=_setup(),
        assembly=work / "assembly.json",
        model=voxelise(arguments.data / "meshes" / "stanford_bunny.ply", 20),
        placement=voxel.PLACEMENT,
    )
    return told(report), poses(shot, stands.photographer, arguments.frames)


def of_partitions(arguments: argparse.Namespace) -> tuple[dict[str, object], dict[str, object]]:
    """Of `probe partitions live`."""
    environment = read_environment_map(arguments.data / "hdr" / arguments.map).resize(128)
    work = arguments.work / "partition"
    stands = partitions.Standing(
        environment, argparse.Namespace(**{**vars(arguments), "work": work, "design": "6d"})
    )
    shot = stands.photographer.film(arguments.frames)
    report = live_scene(
        shot,
        work / "live.mp4",
        scene=VirtualScene(
            mesh=stands.mesh,
            placement=partitions.PLACEMENT,
            cache=work / "live.transfer.npz",
            edge_mm=_EDGE_MM,
            workers=1,
        ),
        setup=_setup(),
        assembly=work / "assembly.json",
        albedo=torch.full((3,), ALBEDO, dtype=torch.float64),
    )
    return told(report), poses(shot, stands.photographer, arguments.frames)


def told(report: LiveReport) -> dict[str, object]:
    """Milliseconds and counts of a film."""
    return {
        "frames": report.frames,
        "tracked": report.tracked,
        "known": report.known,
        "frames_per_s": report.frames_per_s,
        "frame_ms": report.frame_ms,
        "frame_cpu_ms": report.frame_cpu_ms,
        "frames_per_cpu_s": 1000 / report.frame_cpu_ms,
        **{f"{stage}_ms": ms for stage, ms in report.stage_ms.items()},
        **{f"{stage}_cpu_ms": ms for stage, ms in report.stage_cpu_ms.items()},
    }


def poses(shot: Path, photographer: Photographer, frames: int) -> dict[str, object]:
    """Errors of followed and of searched boards, in the frames where both are found.

    Of the probe's middle in the camera's frame, mm, and of the rotation.
    """
    lens = halved(LENS)
    tracker = BoardTracker(BOARD, lens)
    finders: dict[str, Find] = {
        "followed": tracker.pose,
        "searched": lambda image: board_pose(image, BOARD, lens),
    }
    true = photographer.film_poses(frames)
    off: dict[str, list[tuple[float, float]]] = {name: [] for name in finders}
    found, spent = dict.fromkeys(finders, 0), {name: list[float]() for name in finders}
    for frame, pose in zip(film(shot), true, strict=True):
        errors = {}
        for name, find in finders.items():
            begun = time.process_time()
            board = find(frame.image)
            spent[name].append(1000 * (time.process_time() - begun))
            if board is not None and not board.is_ambiguous:
                found[name] += 1
                middle = photographer.middle
                shift = np.linalg.norm(board.pose.points(middle) - pose.points(middle))
                errors[name] = float((board.pose @ pose.inverse()).angle_deg), float(shift)
        if len(errors) == len(finders):
            for name, error in errors.items():
                off[name].append(error)
    facts: dict[str, object] = {"whole_frames_searched_when_followed": tracker.searched}
    for name in finders:
        turn, shift = np.median(off[name], 0)
        facts |= {
            f"{name}_frames": found[name],
            f"{name}_cpu_ms": float(np.median(spent[name])),
            f"{name}_pose_error_deg_median": float(turn),
            f"{name}_pose_error_mm_median": float(shift),
        }
    return facts


def processor() -> str:
    """Its name, as Linux has it."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    return next(line.split(":")[1].strip() for line in lines if line.startswith("model name"))


def _setup() -> Setup:
    return Setup(intrinsics=halved(LENS), board=BOARD, response=Response())


if __name__ == "__main__":
    main()
