"""From a printed probe to a model in a photo, by the command line and an independent renderer.

    DRJIT_LIBLLVM_PATH=... python -m tools.measure_voxel_end_to_end --data DIR --work DIR

Mitsuba renders what a camera would see (extra ``render``): the board alone for the calibration, and
the 3-probe, assembled from its printed parts, on its pole over the board, from above and from
below, with lens distortion, noise and sRGB codes of 8 bits. The commands `camera calibrate`, `probe
voxel capture` and `probe voxel render` do the rest. Compared are the poses with the true ones, the
captured slots with path-traced shading of the probe as it stands (board and pole included), and the
drawn model with a path-traced one in the same light, beside what a perfect capture gives. A film of
640 x 480, in which the camera goes once round below the probe and once above, is for `probe voxel
live`.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import torch

from skylight.imaging._metrics import shading_metrics
from skylight.io._bounded import write_json
from skylight.io._files import read_environment_map, write_png
from skylight.people._independent_render import IndependentScene, Solid, as_photo
from skylight.probes.cameras._board import cylinder_mesh
from skylight.probes.cameras._drawing import camera_rays, looking_at
from skylight.probes.cameras._files import read_setup
from skylight.probes.cameras._intrinsics import load_intrinsics, save_intrinsics
from skylight.probes.fabrication._mount import MarkerBoard, Pole
from skylight.probes.fabrication._parts import PrintSizes
from skylight.probes.voxel._capture_files import live_film
from skylight.probes.voxel._lightmap import Lightmap, load_lightmap
from skylight.probes.voxel._model import (
    NORMALS,
    VoxelModel,
    exposed_faces,
    star_probe,
    voxelise,
    write_voxels,
)
from skylight.probes.voxel._printing import print_voxel_probe, voxel_assembly
from skylight.probes.voxel._printing_files import describe_assembly
from skylight.probes.voxel._relight import VoxelRenderer
from skylight.probes.voxel._render_files import VoxelPlacement, reconstruction_for
from skylight.sphere._envmap import EnvironmentMap
from skylight.transport._cameras import Camera
from skylight.transport._path_tracer import Sampling, shade
from tools.measured import write_measured
from tools.rendered_photos import (
    ALBEDO,
    BOARD,
    MARGIN_MM,
    Photographer,
    as_diffuse_scene,
    board_solid,
    halved,
    run,
)

MODEL_MM = 3.0
PLACEMENT = VoxelPlacement(x_mm=40.0, y_mm=0.0, z_mm=75.0, voxel_mm=MODEL_MM)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="with folders hdr and meshes")
    parser.add_argument("--map", default="abandoned_games_room_02.exr")
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument(
        "--frames", type=int, default=0, help="of a film for live drawing; 0 for none"
    )
    parser.add_argument("--work", type=Path, required=True, help="folder for the pictures")
    parser.add_argument(
        "--out", type=Path, default=Path("benchmarks/results/voxel-end-to-end.json")
    )
    arguments = parser.parse_args()
    begun = time.time()
    environment = read_environment_map(arguments.data / "hdr" / arguments.map).resize(128)
    scene = Standing(environment, arguments.map, arguments.samples, arguments.work)
    scene.photographer.photograph()
    bunny = voxelise(arguments.data / "meshes" / "stanford_bunny.ply", 20)
    facts = scene.measure(bunny)
    if arguments.frames:
        facts["live"] = scene.live(bunny, arguments.frames)
    command = (
        f"python -m tools.measure_voxel_end_to_end --data {arguments.data.name} --work DIR "
        f"--map {arguments.map} --samples {arguments.samples} --frames {arguments.frames}"
    )
    write_measured(
        arguments.out,
        name="voxel-end-to-end",
        what="a printed 3-probe rendered by Mitsuba, captured and drawn with by the command "
        f"line, in the light of {arguments.map}",
        command=command,
        begun=begun,
        facts={"samples": arguments.samples, **facts},
    )


class Standing:
    """The probe on its pole over the board, and the pictures and files of one run."""

    def __init__(self, environment: EnvironmentMap, name: str, samples: int, work: Path) -> None:
        self.environment, self.work = environment, work
        width, height = BOARD.size_mm
        printed = print_voxel_probe(
            star_probe(3),
            PrintSizes(),
            title="3-probe",
            pole=Pole(diameter_mm=6.0, length_mm=230.0),
            board=MarkerBoard(width_mm=width, height_mm=height, margin_mm=MARGIN_MM),
        )
        self.probe = voxel_assembly(printed)
        parts = [
            Solid(
                vertices=self.probe.board_from_probe.points(part.vertices),
                triangles=part.faces,
                albedo=ALBEDO,
            )
            for part in (*printed.printed.parts, printed.mount.foot)
        ]
        assert self.probe.pole_mm is not None
        pole = cylinder_mesh(self.probe.pole_mm)
        self.around = [
            Solid(vertices=pole[0], triangles=pole[1], albedo=ALBEDO),
            board_solid(),
        ]
        self.photographer = Photographer(
            work=work,
            name=name,
            environment=environment,
            solids=[*parts, *self.around],
            middle=self.probe.to_board(np.full(3, 1.5)),
            samples=samples,
        )
        write_json(work / "assembly.json", describe_assembly(printed))

    def live(self, model: VoxelModel, frames: int) -> dict[str, object]:
        """Frames a second of `probe voxel live`, median milliseconds of each stage."""
        work = self.work
        save_intrinsics(work / "small.json", halved(load_intrinsics(work / "camera.json")))
        report = live_film(
            self.photographer.film(frames),
            work / "live.mp4",
            setup=read_setup(work / "small.json", work / "board.json", None),
            assembly=work / "assembly.json",
            model=model,
            placement=PLACEMENT,
        )
        return {
            "frames": report.frames,
            "tracked": report.tracked,
            "slots": report.known,
            "frames_per_s": report.frames_per_s,
            **{f"{stage}_ms": ms for stage, ms in report.stage_ms.items()},
        }

    def measure(self, model: VoxelModel) -> dict[str, object]:
        """The command line's results beside the truth."""
        self.photographer.calibrate()
        capture = self.work / "capture"
        (capture / "lightmap.npz").unlink(missing_ok=True)
        files = self.photographer.command_files
        assembly = ["--assembly", str(self.work / "assembly.json")]
        photos = map(str, self.photographer.photos)
        run(["probe", "voxel", "capture", *photos, *files, *assembly, "--out", str(capture)])
        facts = self.photographer.pose_errors(load_intrinsics(self.work / "camera.json"))
        found, true = load_lightmap(capture / "lightmap.npz"), self._true_lightmap()
        return facts | _slot_errors(found, true) | self._drawings(model, found, true)

    def _true_lightmap(self) -> Lightmap:
        """Path-traced shading of the ideal probe as it stands, board and pole included."""
        faces = exposed_faces(star_probe(3))
        place = self.probe
        vertices, triangles = faces.triangles()
        ideal = Solid(
            vertices=place.to_board(vertices.numpy()), triangles=triangles.numpy(), albedo=ALBEDO
        )
        points = place.to_board(faces.points(16).numpy()).reshape(-1, 3)
        normals = place.board_from_probe.directions(
            NORMALS[faces.orientation.numpy()].astype(float)
        )
        traced = shade(
            torch.from_numpy(points),
            torch.from_numpy(normals.repeat(256, 0)),
            as_diffuse_scene([ideal, *self.around]),
            self.environment,
            albedo=ALBEDO,
            sampling=Sampling(samples=512),
            generator=torch.Generator().manual_seed(1),
        ).mean
        radiance = torch.zeros(6, 32, 16, 16, 3)
        radiance[faces.orientation, faces.configuration] = traced.reshape(-1, 16, 16, 3).float()
        known = torch.zeros(6, 32)
        known[faces.orientation, faces.configuration] = 1
        exposure = self.photographer.exposure
        return Lightmap(radiance=radiance * exposure, coverage=known, confidence=known)

    def _drawings(self, model: VoxelModel, found: Lightmap, true: Lightmap) -> dict[str, object]:
        """The model in a photo, beside path tracing, from a perfect capture and from this one."""
        work = self.work
        write_voxels(work / "bunny.npy", model)
        place = ["--at-mm", "40", "0", "75", "--voxel-mm", str(MODEL_MM)]
        run(
            ["probe", "voxel", "render", str(work / "bunny.npy"), "--lightmap",
             str(work / "capture" / "lightmap.npz"), "--out", str(work / "composite.png"),
             "--photo", str(work / "probe_00.png"), *self.photographer.command_files, *place]
        )  # fmt: skip
        pose = self.photographer.pose(0)
        view = Camera(focal_px=600.0, width=320, height=320, center_px=(160.0, 160.0))
        matrix = PLACEMENT.matrix(model)
        middle = matrix[:3, :3] @ (torch.tensor(model.occupied.shape).double() / 2) + matrix[:3, 3]
        eye = pose.inverse().translation - middle
        pose = looking_at(middle + eye * (170 / eye.norm()), middle)
        renderer = VoxelRenderer(model, matrix)
        vertices, triangles = exposed_faces(model).triangles()
        world = vertices @ matrix[:3, :3].T + matrix[:3, 3]
        solid = Solid(vertices=world.numpy(), triangles=triangles.numpy(), albedo=ALBEDO)
        alone = IndependentScene([solid], self.environment)
        reference = torch.from_numpy(
            alone.radiance(
                view, pose.rotation.numpy(), pose.translation.numpy(), samples=512, seed=7
            )
        )
        reference = reference * self.photographer.exposure
        rays = camera_rays(view)
        facts: dict[str, object] = {}
        shown = [reference]
        for kind in ("direct", "global"):
            error = {}
            for name, lightmap in (("capture", found), ("perfect", true)):
                completed = reconstruction_for(lightmap, kind, ALBEDO).complete(lightmap)
                drawing = renderer.draw(completed, rays, pose)
                scores = shading_metrics(drawing.radiance, reference, drawing.alpha == 1)
                error[name] = facts[f"{name}_{kind}_mae"] = scores["mae"]
                facts[f"{name}_{kind}_ssim"] = scores["ssim"]
                shown.append(drawing.radiance)
            facts[f"{kind}_mae_ratio"] = error["capture"] / error["perfect"]
        strip = as_photo(torch.cat(shown, 1).numpy(), exposure=1.0, noise=0.0, seed=0)
        write_png(work / "drawings.png", strip)
        return facts


def _slot_errors(found: Lightmap, true: Lightmap) -> dict[str, object]:
    both = found.known & true.known
    means = [m.radiance[both].mean((1, 2)) for m in (found, true)]
    relative = (means[0] - means[1]).abs() / means[1].mean(1, keepdim=True)
    texels = (found.radiance - true.radiance)[both].abs().mean((1, 2, 3))
    texels = texels / true.radiance[both].mean((1, 2, 3))
    return {
        "slots_captured": int(found.known.sum()),
        "slot_error_median": float(relative.mean(1).median()),
        "slot_error_max": float(relative.mean(1).max()),
        "texel_error_median": float(texels.median()),
    }


if __name__ == "__main__":
    main()
