"""From a printed partition probe to a scene in a photo, by the command line and another renderer.

    DRJIT_LIBLLVM_PATH=... python -m tools.measure_partition_end_to_end --data DIR --work DIR

Mitsuba renders what a camera would see (extra ``render``): the board alone for the calibration, and
the probe as printed (shells of black paint, 4 % albedo, and a white kernel) on its pole over the
board. The commands `camera calibrate`, `probe partitions capture` and `probe partitions relight` do
the rest. Compared are the samples with path-traced shading of the kernel as it stands, and the
composite with a rendered picture of the mesh on the board in the same light, beside what a perfect
capture gives. The same with probes that stand 0.5 degrees off, about their pole or about other
axes, and a kernel whose albedo is thought to be 10 % higher; capturing aligns what it can. A film
of 640 x 480 is for `probe partitions live`.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float

from skylight.imaging._metrics import mae
from skylight.io._bounded import write_json
from skylight.io._files import read_environment_map, write_png
from skylight.people._independent_render import IndependentScene, Solid
from skylight.probes.cameras._board import cylinder_mesh
from skylight.probes.cameras._drawing import lens_rays
from skylight.probes.cameras._files import read_setup
from skylight.probes.cameras._intrinsics import load_intrinsics, save_intrinsics
from skylight.probes.cameras._live import read_picture
from skylight.probes.cameras._response import Response
from skylight.probes.fabrication._mount import MarkerBoard, Pole
from skylight.probes.partitions._captured import FaceDiscs, ProbeCapture, load_capture, save_capture
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions._printing_files import describe_partition_assembly
from skylight.probes.partitions._relight_files import ScenePlacement, VirtualScene, live_scene
from skylight.probes.partitions.printed._assembly import PartitionAssembly
from skylight.probes.partitions.printed._printing import print_partition_probe
from skylight.probes.partitions.printed._solids import ProbeSizes
from skylight.probes.partitions.relight._scene import read_scene
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._rotation import RigidTransform
from skylight.transport._path_tracer import Sampling, shade
from skylight.transport._rays import Raycaster
from tools.measured import write_measured
from tools.rendered_photos import (
    ALBEDO,
    BLACK,
    BOARD,
    LENS,
    MARGIN_MM,
    Photographer,
    as_diffuse_scene,
    bent_picture,
    board_solid,
    halved,
    run,
)

MESH_ALBEDO = 0.7
PLACEMENT = ScenePlacement(x_mm=40.0, z_mm=75.0, height_mm=50.0)
OFF_DEG, ALBEDO_ERROR = 0.5, 1.1
_RING_PX = 61  # round the mesh, where its shadow falls
_LIVE_EDGE_MM = 2.0


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="with folders hdr and meshes")
    parser.add_argument("--map", default="abandoned_games_room_02.exr")
    parser.add_argument("--design", default="6d")
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--frames", type=int, default=0, help="of a film; 0 for none")
    parser.add_argument("--work", type=Path, required=True, help="folder for the pictures")
    parser.add_argument("--out", type=Path, default=None)
    arguments = parser.parse_args()
    begun = time.time()
    environment = read_environment_map(arguments.data / "hdr" / arguments.map).resize(128)
    scene = Standing(environment, arguments)
    scene.photographer.photograph()
    facts = scene.measure()
    if arguments.frames:
        facts["live"] = scene.live(arguments.frames)
    name = f"partition-end-to-end-{arguments.design}"
    command = (
        f"python -m tools.measure_partition_end_to_end --data {arguments.data.name} --work DIR "
        f"--map {arguments.map} --design {arguments.design} --samples {arguments.samples} "
        f"--frames {arguments.frames}"
    )
    write_measured(
        arguments.out or Path(f"benchmarks/results/{name}.json"),
        name=name,
        what=f"a printed {arguments.design} probe rendered by Mitsuba, captured and relit "
        f"from by the command line, in the light of {arguments.map}",
        command=command,
        begun=begun,
        facts={"samples": arguments.samples, **facts},
    )


class Standing:
    """The probe on its pole over the board, and the pictures and files of one run."""

    def __init__(self, environment: EnvironmentMap, arguments: argparse.Namespace) -> None:
        self.environment, self.work = environment, arguments.work
        self.mesh = arguments.data / "meshes" / "spot.ply"
        width, height = BOARD.size_mm
        printed = print_partition_probe(
            named_design(arguments.design),
            ProbeSizes(),
            pole=Pole(diameter_mm=6.0, length_mm=190.0),
            board=MarkerBoard(width_mm=width, height_mm=height, margin_mm=MARGIN_MM),
        )
        self.probe = printed.assembly
        parts = printed.printed
        moved = self.probe.board_from_probe.translation.numpy()
        self.solids = [
            *(
                Solid(vertices=part.vertices + moved, triangles=part.faces, albedo=albedo)
                for part, albedo in (
                    (parts.lower, BLACK), (parts.upper, BLACK), (parts.kernel, ALBEDO)
                )
            ),
            _pole(self.probe),
            board_solid(),
        ]  # fmt: skip
        self.photographer = Photographer(
            work=arguments.work,
            name=f"{arguments.design} {arguments.map}",
            environment=environment,
            solids=self.solids,
            middle=moved,
            samples=arguments.samples,
        )
        write_json(self.work / "assembly.json", describe_partition_assembly(printed))

    def measure(self) -> dict[str, object]:
        """The command line's results beside the truth."""
        self.photographer.calibrate()
        facts = self.photographer.pose_errors(load_intrinsics(self.work / "camera.json"))
        self._capture("capture", "assembly.json", ALBEDO)
        for name, axis in _off_axes().items():
            told = standing_off(self.probe, axis).to_json()
            write_json(self.work / f"{name}.json", told)
            self._capture(name, f"{name}.json", ALBEDO * ALBEDO_ERROR)
        true = self._true_shading()
        found = load_capture(self.work / "capture" / "shading.json")
        save_capture(
            self.work / "perfect.json",
            replace(found, shading=true, area_px=np.ones(len(true)), clipped=np.zeros(len(true))),
        )
        facts |= {"cells_captured": int(found.known.sum()), **_errors("sample", found, true)}
        for name in _off_axes():
            facts |= _errors(
                f"{name}_sample", load_capture(self.work / name / "shading.json"), true
            )
        return facts | self._composites()

    def live(self, frames: int) -> dict[str, object]:
        """Frames a second of `probe partitions live`, median milliseconds of each stage."""
        work = self.work
        save_intrinsics(work / "small.json", halved(load_intrinsics(work / "camera.json")))
        scene = VirtualScene(
            mesh=self.mesh,
            placement=PLACEMENT,
            cache=work / "live.transfer.npz",
            edge_mm=_LIVE_EDGE_MM,
            workers=2,
        )
        report = live_scene(
            self.photographer.film(frames),
            work / "live.mp4",
            scene=scene,
            setup=read_setup(work / "small.json", work / "board.json", None),
            assembly=work / "assembly.json",
            capture=None,
            albedo=torch.full((3,), ALBEDO, dtype=torch.float64),
        )
        return {
            "vertices": len(self._mesh_on_board().vertices),
            "frames": report.frames,
            "tracked": report.tracked,
            "cells": report.known,
            "frames_per_s": report.frames_per_s,
            **{f"{stage}_ms": ms for stage, ms in report.stage_ms.items()},
        }

    def _capture(self, name: str, assembly: str, albedo: float) -> None:
        out = self.work / name
        (out / "shading.json").unlink(missing_ok=True)
        run(
            ["probe", "partitions", "capture", *map(str, self.photographer.photos),
             *self.photographer.command_files, "--assembly", str(self.work / assembly),
             "--albedo", f"{albedo:g}", "--out", str(out)]
        )  # fmt: skip

    def _true_shading(self) -> Float[np.ndarray, "n 3"]:
        """Path-traced means of the faces' discs as they stand: paint, pole and board included."""
        discs = FaceDiscs(self.probe.placed())
        cells, places, _ = discs.inside.shape
        normals = torch.from_numpy(discs.probe.normals).repeat_interleave(places, 0)
        traced = shade(
            torch.from_numpy(discs.inside.reshape(-1, 3)),
            normals,
            as_diffuse_scene(self.solids),
            self.environment,
            albedo=ALBEDO,
            sampling=Sampling(samples=2048),
            generator=torch.Generator().manual_seed(1),
        ).mean
        shading = traced.reshape(cells, places, 3).mean(1).numpy()
        return shading * self.photographer.exposure

    def _composites(self) -> dict[str, object]:
        """Errors of the composites, of the mesh and of its surroundings, relative to their means.

        ``empty_ring_mae`` is that of the photo without the mesh: all of the shadow is missing.
        """
        work, placement = self.work, PLACEMENT
        photo = self.photographer.photos[0]
        place = [str(v) for v in (placement.x_mm, placement.y_mm, placement.z_mm)]
        files = {"perfect": (work / "assembly.json", work / "perfect.json")}
        for name in ("capture", *_off_axes()):
            files[name] = (work / name / "assembly.json", work / name / "shading.json")
        for name, (assembly, capture) in files.items():
            run(
                ["probe", "partitions", "relight", "--scene", str(self.mesh), "--photo", str(photo),
                 "--at-mm", *place, "--height-mm", str(placement.height_mm),
                 "--probe", str(assembly), "--capture", str(capture),
                 *self.photographer.command_files, "--cache", str(work / f"{name}.transfer.npz"),
                 "--out", str(work / f"{name}.png")]
            )  # fmt: skip
        truth, mesh, ring = self._reference()
        shown = {"reference": Response().encode(truth), "photo": read_picture(photo).image}
        facts: dict[str, object] = {
            "empty_ring_mae": mae(Response().linearise(shown["photo"])[ring], truth[ring])
        }
        error = {}
        for name in files:
            shown[name] = read_picture(work / f"{name}.png").image
            found = Response().linearise(shown[name])
            error[name] = facts[f"{name}_mae"] = mae(found[mesh], truth[mesh])
            facts[f"{name}_ring_mae"] = mae(found[ring], truth[ring])
        facts["mae_ratio"] = error["capture"] / error["perfect"]
        off = [error[name] / error["perfect"] for name in _off_axes()]
        facts |= {"off_mae_ratio_median": float(np.median(off)), "off_mae_ratio_max": max(off)}
        rows, columns = (slice(v.min(), v.max()) for v in np.nonzero(ring.numpy()))
        write_png(work / "composites.png", np.hstack([p[rows, columns] for p in shown.values()]))
        return facts

    def _mesh_on_board(self) -> Solid:
        scene = PLACEMENT.placed(read_scene(self.mesh, (MESH_ALBEDO, MESH_ALBEDO, MESH_ALBEDO)))
        return Solid(
            vertices=scene.vertices.numpy(), triangles=scene.faces.numpy(), albedo=MESH_ALBEDO
        )

    def _reference(
        self,
    ) -> tuple[Float[torch.Tensor, "h w 3"], Bool[torch.Tensor, "h w"], Bool[torch.Tensor, "h w"]]:
        """(the mesh on the board beside the probe, where the mesh is, the board round it)."""
        mesh, pose = self._mesh_on_board(), self.photographer.pose(0)
        scene = IndependentScene([*self.solids, mesh], self.environment)
        truth = bent_picture(scene, pose, 256, 7, LENS) * self.photographer.exposure
        rays = lens_rays(LENS).reshape(-1, 3) @ pose.rotation
        eye = pose.inverse().translation.expand(len(rays), 3)

        def seen(solids: list[Solid]) -> Bool[np.ndarray, "h w"]:
            joined = as_diffuse_scene(solids)
            face = Raycaster(joined.vertices, joined.faces).faces_hit(eye, rays)
            return (face >= 0).numpy().reshape(LENS.height, LENS.width)

        # pixels at an edge show both sides of it
        inner = cv2.erode(seen([mesh]).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        outer = cv2.dilate(seen([mesh]).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        around = cv2.dilate(outer.astype(np.uint8), np.ones((_RING_PX, _RING_PX), np.uint8)) > 0
        probe = cv2.dilate(seen(self.solids[:-1]).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        board = cv2.erode(seen(self.solids[-1:]).astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
        ring = around & ~outer & ~probe & board
        return torch.from_numpy(truth), torch.from_numpy(inner), torch.from_numpy(ring)


def _off_axes() -> dict[str, Float[np.ndarray, "3"]]:
    """About its pole, and about two axes drawn at random."""
    drawn = np.random.default_rng(0).standard_normal((2, 3))
    axes = np.stack([[0.0, 1.0, 0.0], *drawn])
    return {f"off_{i}": axis / np.linalg.norm(axis) for i, axis in enumerate(axes)}


def standing_off(probe: PartitionAssembly, axis: Float[np.ndarray, "3"]) -> PartitionAssembly:
    """Thought to stand upright, but half a degree off about an axis through its foot."""
    x, z = probe.pole_mm[:2]
    vector = torch.from_numpy(np.concatenate([np.radians(OFF_DEG) * axis, np.zeros(3)]))
    motion = RigidTransform.from_vector(vector).about(torch.tensor([x, 0.0, z]).double())
    return replace(probe, board_from_probe=motion @ probe.board_from_probe)


def _pole(probe: PartitionAssembly) -> Solid:
    vertices, triangles = cylinder_mesh(probe.pole_mm)
    return Solid(vertices=vertices, triangles=triangles, albedo=ALBEDO)


def _errors(name: str, found: ProbeCapture, true: Float[np.ndarray, "n 3"]) -> dict[str, object]:
    """Of the cells that were captured, relative to each one's mean."""
    off = np.abs(found.shading.numpy() - true).mean(1) / true.mean(1)
    return {
        f"{name}_error_median": float(np.median(off[found.known.numpy()])),
        f"{name}_error_max": float(off[found.known.numpy()].max()),
    }


if __name__ == "__main__":
    main()
