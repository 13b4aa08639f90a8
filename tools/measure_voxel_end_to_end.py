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
import json
import platform
import time
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
import torch

from skylight.app.probe_printing import describe_assembly, print_voxel_probe, standing_probe
from skylight.app.voxel_capture import read_setup
from skylight.app.voxel_live import live_film
from skylight.app.voxel_render import Stand, reconstruction_for
from skylight.cli import main as skylight
from skylight.evaluation.independent_render import IndependentScene, Solid, as_photo
from skylight.evaluation.main import commit
from skylight.imaging.files import read_environment_map, write_json, write_png
from skylight.imaging.metrics import shading_metrics
from skylight.probes.capture.board import Board, save_board
from skylight.probes.capture.frames import read_picture
from skylight.probes.capture.intrinsics import (
    FLIP,
    Intrinsics,
    load_intrinsics,
    save_intrinsics,
)
from skylight.probes.capture.pose import Pose, board_pose
from skylight.probes.printing.mount import MarkerBoard, Pole
from skylight.probes.printing.sizes import PrintSizes
from skylight.probes.voxel.faces import NORMALS, exposed_faces
from skylight.probes.voxel.lightmap import Lightmap, load_lightmap
from skylight.probes.voxel.model import VoxelModel, star_probe, voxelise, write_voxels
from skylight.probes.voxel.render import VoxelRenderer, camera_rays, lens_rays, looking_at
from skylight.sphere.envmap import EnvironmentMap
from skylight.transport.camera import Camera
from skylight.transport.path_tracer import DiffuseScene, Sampling, shade

ALBEDO, BLACK, WHITE = 0.8, 0.04, 0.85
BOARD = Board(columns=7, rows=5, square_mm=25.0, marker_mm=18.0)
LENS = Intrinsics(
    width=1280, height=960, fx=1050.0, fy=1052.0, cx=634.0, cy=483.0,
    k1=-0.11, k2=0.06, p1=8e-4, p2=-5e-4,
)  # fmt: skip
NOISE = 1.5  # codes
PER_MM = 8
MARGIN_MM = 5.0
CALIBRATION = [  # tilts about x and z, degrees, distance, shift right and up, mm
    (0, 0, 330, 0, 0), (30, 0, 330, -40, 20), (-30, 5, 330, 40, -20), (0, 30, 350, 30, 20),
    (5, -30, 350, -30, -20), (25, 25, 380, 60, 30), (-25, -22, 380, -60, 40),
    (-20, 25, 300, -40, -40), (32, -20, 360, 70, -40), (10, 10, 280, 0, 10),
]  # fmt: skip
MODEL_MM = 3.0
VIEWS = [(a, 38.0) for a in range(0, 360, 45)] + [(a + 22.5, -16.0) for a in range(0, 360, 45)]


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
    scene.photograph()
    bunny = voxelise(arguments.data / "meshes" / "stanford_bunny.ply", 20)
    facts = scene.measure(bunny)
    if arguments.frames:
        scene.film(arguments.frames)
        facts["live"] = scene.live(bunny)
    command = (
        f"python -m tools.measure_voxel_end_to_end --data {arguments.data.name} --work DIR "
        f"--map {arguments.map} --samples {arguments.samples} --frames {arguments.frames}"
    )
    write_json(
        arguments.out,
        {
            "name": "voxel-end-to-end",
            "what": "a printed 3-probe rendered by Mitsuba, captured and drawn with by the command "
            f"line, in the light of {arguments.map}",
            "command": command,
            "commit": commit(),
            "date": datetime.now(UTC).date().isoformat(),
            "machine": f"{platform.machine()}, torch {torch.__version__}",
            "seed": 0,
            "samples": arguments.samples,
            "seconds": time.time() - begun,
            **facts,
        },
    )
    print(json.dumps(facts, indent=2))


class Standing:
    """The probe on its pole over the board, and the pictures and files of one run."""

    def __init__(self, environment: EnvironmentMap, name: str, samples: int, work: Path) -> None:
        self.environment, self.samples, self.work = environment, samples, work
        work.mkdir(parents=True, exist_ok=True)
        width, height = BOARD.size_mm
        self.printed = print_voxel_probe(
            star_probe(3),
            PrintSizes(),
            title="3-probe",
            pole=Pole(diameter_mm=6.0, length_mm=230.0),
            board=MarkerBoard(width_mm=width, height_mm=height, margin_mm=MARGIN_MM),
        )
        self.probe = standing_probe(self.printed)
        self.board = _board_solid()
        place = self.probe.placement
        parts = [
            Solid(
                vertices=part.vertices @ place.rotation.T + place.translation_mm,
                triangles=part.faces,
                albedo=ALBEDO,
            )
            for part in (*self.printed.printed.parts, self.printed.mount.foot)
        ]
        placed = self.probe.placed()
        self.placed = placed
        pole = placed.obstacle
        assert pole is not None
        self.pole = Solid(vertices=pole[0], triangles=pole[1], albedo=ALBEDO)
        self.all = [*parts, self.pole, self.board]
        self.middle = place.to_board(np.full(3, 1.5))
        # 0.8 of a white face under the whole light is well below the codes' top
        level = float(
            environment.radiance.mean(-1).flatten() @ environment.grid.solid_angles.float()
        )
        self.exposure = 0.55 / (ALBEDO * level / (4 * np.pi) * 1.6)
        key = {"map": name, "samples": samples, "lens": asdict(LENS), "views": VIEWS}
        told = work / "pictures.json"
        if told.exists() and told.read_text() != json.dumps(key):
            raise SystemExit(f"{work} has pictures of other settings: choose another --work")
        told.write_text(json.dumps(key))
        save_board(work / "board.json", BOARD)
        write_json(work / "assembly.json", describe_assembly(self.printed))

    def photograph(self) -> None:
        """Calibration pictures, and the probe from all sides."""
        flat = IndependentScene([self.board], self.environment)
        for i, (tilt_x, tilt_z, distance, right, up) in enumerate(CALIBRATION):
            pose = _calibration_pose(tilt_x, tilt_z, distance, right, up)
            path = self.work / f"calibration_{i:02d}.png"
            if not path.exists():  # those of a run that was stopped are kept
                write_png(path, self._photo(flat, pose, 16, i))
        whole = IndependentScene(self.all, self.environment)
        for i in range(len(VIEWS)):
            path = self.work / f"probe_{i:02d}.png"
            if not path.exists():
                write_png(path, self._photo(whole, self.pose(i), self.samples, 100 + i))
            print(f"photo {i + 1} of {len(VIEWS)}", flush=True)

    def pose(self, number: int) -> Pose:
        """The true pose of a picture."""
        return self.pose_from(*VIEWS[number])

    def pose_from(self, azimuth_deg: float, elevation_deg: float) -> Pose:
        """From above towards board and probe, or from below the probe."""
        azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
        flat = np.array([np.sin(azimuth), 0, np.cos(azimuth)]) * np.cos(elevation)
        towards = flat + np.array([0, np.sin(elevation), 0])
        above = elevation > 0
        # the probe and the board fill the picture's height
        target = self.middle - np.array([0, 80.0 if above else 95.0, 0])
        eye = self.middle + (420.0 if above else 370.0) * towards
        rotation, translation = looking_at(torch.from_numpy(eye), torch.from_numpy(target))
        return Pose(rotation=rotation.numpy(), translation=translation.numpy())

    def film(self, count: int) -> None:
        """film.avi: once round below the probe, once round above it."""
        path = self.work / "film.avi"
        if path.exists():
            return
        whole = IndependentScene(self.all, self.environment)
        code = cv2.VideoWriter.fourcc(*"MJPG")
        partial = self.work / "partial.avi"
        made = cv2.VideoWriter(str(partial), cv2.CAP_FFMPEG, code, 30.0, (640, 480))
        half = -(-count // 2)
        for i in range(count):
            pose = self.pose_from(360 * (i % half) / half, -16.0 if i < half else 38.0)
            frame = self._photo(whole, pose, self.samples, 1000 + i, lens=halved(LENS))
            made.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
            print(f"frame {i + 1} of {count}", flush=True)
        made.release()
        partial.rename(path)

    def live(self, model: VoxelModel) -> dict[str, object]:
        """Frames a second of `probe voxel live`, median milliseconds of each stage."""
        work = self.work
        save_intrinsics(work / "small.json", halved(load_intrinsics(work / "camera.json")))
        report = live_film(
            work / "film.avi",
            work / "live.mp4",
            setup=read_setup(work / "small.json", work / "board.json", None),
            assembly=work / "assembly.json",
            model=model,
            stand=Stand(x_mm=40.0, y_mm=0.0, z_mm=75.0, voxel_mm=MODEL_MM),
        )
        return {
            "frames": report.frames,
            "tracked": report.tracked,
            "slots": report.slots,
            "frames_per_s": report.frames_per_s,
            **{f"{stage}_ms": ms for stage, ms in report.stage_ms.items()},
        }

    def _photo(
        self,
        scene: IndependentScene,
        pose: Pose,
        samples: int,
        seed: int,
        lens: Intrinsics = LENS,
    ) -> np.ndarray:
        """Rendered by a pinhole with room around it, then bent as the lens does."""
        width, height = round(1.17 * lens.width), round(1.19 * lens.height)
        wide = Camera(
            focal_px=lens.fx, width=width, height=height, center_px=(width / 2, height / 2)
        )
        linear = scene.radiance(wide, pose.rotation, pose.translation, samples=samples, seed=seed)
        rays = lens_rays(lens)[:, :, 0].numpy() @ FLIP
        x = (rays[..., 0] / rays[..., 2] * wide.focal_px + wide.center_px[0] - 0.5).astype(
            np.float32
        )
        y = (rays[..., 1] / rays[..., 2] * wide.focal_px + wide.center_px[1] - 0.5).astype(
            np.float32
        )
        bent = cv2.remap(linear, x, y, cv2.INTER_LINEAR)
        return as_photo(bent, exposure=self.exposure, noise=NOISE, seed=seed)

    def measure(self, model: VoxelModel) -> dict[str, object]:
        """The command line's results beside the truth."""
        work = self.work
        calibration = sorted(map(str, work.glob("calibration_*.png")))
        photos = sorted(map(str, work.glob("probe_*.png")))
        files = ["--board", str(work / "board.json")]
        camera = ["--camera", str(work / "camera.json")]
        _run(["camera", "calibrate", *calibration, *files, "--out", str(work / "camera.json")])
        capture = work / "capture"
        (capture / "lightmap.npz").unlink(missing_ok=True)
        assembly = ["--assembly", str(work / "assembly.json")]
        _run(
            [
                "probe",
                "voxel",
                "capture",
                *photos,
                *camera,
                *files,
                *assembly,
                "--out",
                str(capture),
            ]
        )
        lens = load_intrinsics(work / "camera.json")
        facts: dict[str, object] = {
            "focal_px": [lens.fx, lens.fy],
            "true_focal_px": [LENS.fx, LENS.fy],
            **self._pose_errors(lens),
        }
        found = load_lightmap(capture / "lightmap.npz")
        facts |= self._slot_errors(found)
        return facts | self._drawings(model, found, camera, files)

    def _pose_errors(self, lens: Intrinsics) -> dict[str, object]:
        """Of the probe's middle in the camera's frame, mm, and of the rotation."""
        shifts, turns, missing = [], [], 0
        for i in range(len(VIEWS)):
            found = board_pose(read_picture(self.work / f"probe_{i:02d}.png").image, BOARD, lens)
            if found is None or found.is_ambiguous:
                missing += 1
                continue
            true = self.pose(i)
            both = [p.to_camera(self.middle[None])[0] for p in (found.pose, true)]
            shifts.append(float(np.linalg.norm(both[0] - both[1])))
            cosine = (np.trace(found.pose.rotation @ true.rotation.T) - 1) / 2
            turns.append(float(np.degrees(np.arccos(np.clip(cosine, -1, 1)))))
        return {
            "poses_found": len(shifts),
            "poses_missing": missing,
            "pose_error_mm_median": float(np.median(shifts)),
            "pose_error_mm_max": max(shifts),
            "pose_error_deg_median": float(np.median(turns)),
            "pose_error_deg_max": max(turns),
        }

    def _true_lightmap(self) -> Lightmap:
        """Path-traced shading of the ideal probe as it stands, board and pole included."""
        faces = exposed_faces(star_probe(3))
        place = self.probe.placement
        vertices, triangles = faces.triangles()
        solids = [(place.to_board(vertices.numpy()), triangles.numpy(), ALBEDO)]
        solids.append((self.pole.vertices, self.pole.triangles, ALBEDO))
        solids.append((self.board.vertices, self.board.triangles, _mean_albedo(self.board)))
        scene = _joined(solids)
        points = place.to_board(faces.points(16).numpy()).reshape(-1, 3)
        normals = NORMALS[faces.orientation.numpy()] @ place.rotation.T
        traced = shade(
            torch.from_numpy(points),
            torch.from_numpy(normals.repeat(256, 0)),
            scene,
            self.environment,
            albedo=ALBEDO,
            sampling=Sampling(samples=512),
            generator=torch.Generator().manual_seed(1),
        ).mean
        radiance = torch.zeros(6, 32, 16, 16, 3)
        radiance[faces.orientation, faces.configuration] = traced.reshape(-1, 16, 16, 3).float()
        known = torch.zeros(6, 32)
        known[faces.orientation, faces.configuration] = 1
        return Lightmap(radiance=radiance * self.exposure, coverage=known, confidence=known)

    def _slot_errors(self, found: Lightmap) -> dict[str, object]:
        true = self._true_lightmap()
        self.true = true
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

    def _drawings(
        self, model: VoxelModel, found: Lightmap, camera: list[str], files: list[str]
    ) -> dict:
        """The model in a photo, beside path tracing, from a perfect capture and from this one."""
        work = self.work
        write_voxels(work / "bunny.npy", model)
        stand = Stand(x_mm=40.0, y_mm=0.0, z_mm=75.0, voxel_mm=MODEL_MM)
        place = ["--at-mm", "40", "0", "75", "--voxel-mm", str(MODEL_MM)]
        photo = work / "probe_00.png"
        _run(
            ["probe", "voxel", "render", str(work / "bunny.npy"), "--lightmap",
             str(work / "capture" / "lightmap.npz"), "--out", str(work / "composite.png"),
             "--photo", str(photo), *camera, *files, *place]
        )  # fmt: skip
        pose = self.pose(0)
        view = Camera(focal_px=600.0, width=320, height=320, center_px=(160.0, 160.0))
        matrix = stand.matrix(model)
        middle = matrix[:3, :3] @ (torch.tensor(model.occupied.shape).double() / 2) + matrix[:3, 3]
        eye = torch.from_numpy(pose.position) - middle
        rotation, translation = looking_at(middle + eye * (170 / eye.norm()), middle)
        renderer = VoxelRenderer(model, matrix)
        vertices, triangles = exposed_faces(model).triangles()
        world = vertices @ matrix[:3, :3].T + matrix[:3, 3]
        solid = Solid(vertices=world.numpy(), triangles=triangles.numpy(), albedo=ALBEDO)
        alone = IndependentScene([solid], self.environment)
        reference = torch.from_numpy(
            alone.radiance(view, rotation.numpy(), translation.numpy(), samples=512, seed=7)
        )
        reference = reference * self.exposure
        rays = camera_rays(view)
        facts: dict[str, float] = {}
        shown = [reference]
        for kind in ("direct", "global"):
            for name, lightmap in (("capture", found), ("perfect", self.true)):
                completed = reconstruction_for(lightmap, kind, ALBEDO).complete(lightmap)
                drawing = renderer.draw(completed, rays, rotation, translation)
                mask = drawing.alpha == 1
                scores = shading_metrics(drawing.radiance, reference, mask)
                facts[f"{name}_{kind}_mae"] = scores["mae"]
                facts[f"{name}_{kind}_ssim"] = scores["ssim"]
                shown.append(drawing.radiance)
            facts[f"{kind}_mae_ratio"] = facts[f"capture_{kind}_mae"] / facts[f"perfect_{kind}_mae"]
        strip = as_photo(torch.cat(shown, 1).numpy(), exposure=1.0, noise=0.0, seed=0)
        write_png(work / "drawings.png", strip)
        return facts


def halved(lens: Intrinsics) -> Intrinsics:
    """The same lens for pictures of half the size; a pixel's centre goes with its corner."""
    return replace(
        lens,
        width=lens.width // 2,
        height=lens.height // 2,
        fx=lens.fx / 2,
        fy=lens.fy / 2,
        cx=(lens.cx + 0.5) / 2 - 0.5,
        cy=(lens.cy + 0.5) / 2 - 0.5,
    )


def _run(arguments: list[str]) -> None:
    if skylight(arguments) != 0:
        raise SystemExit(f"skylight {' '.join(arguments[:3])} failed")


def _calibration_pose(
    tilt_x: float, tilt_z: float, distance: float, right: float, up: float
) -> Pose:
    """A camera above the board's middle, looking down, tilted and shifted."""
    width, height = BOARD.size_mm
    middle = np.array([width / 2, 0, height / 2])
    a, b = np.radians(90 - tilt_x), np.radians(tilt_z)
    offset = np.array([np.sin(b) * np.sin(a), np.sin(a) * np.cos(b), np.cos(a) + 1e-3])
    rotation, translation = looking_at(
        torch.from_numpy(middle + distance * offset), torch.from_numpy(middle)
    )
    return Pose(
        rotation=rotation.numpy(), translation=translation.numpy() + np.array([right, up, 0.0])
    )


def _board_solid() -> Solid:
    """The printed paper with its margin, painted at 8 pixels a mm."""
    width, height = BOARD.size_mm
    m = MARGIN_MM
    paint = np.full((round((height + 2 * m) * PER_MM), round((width + 2 * m) * PER_MM), 3), WHITE)
    for left, top, w, h in BOARD.dark_rectangles():
        rows = slice(round((top + m) * PER_MM), round((top + m + h) * PER_MM))
        columns = slice(round((left + m) * PER_MM), round((left + m + w) * PER_MM))
        paint[rows, columns] = BLACK
    corners = [(-m, -m), (width + m, -m), (width + m, height + m), (-m, height + m)]
    return Solid(
        vertices=np.array([(x, 0.0, z) for x, z in corners]),
        triangles=np.array([[0, 2, 1], [0, 3, 2]]),
        paint=paint,
        uv=np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]]),
    )


def _mean_albedo(board: Solid) -> float:
    assert board.paint is not None
    return float(board.paint.mean())


def _joined(solids: list[tuple[np.ndarray, np.ndarray, float]]) -> DiffuseScene:
    vertices, triangles, albedo, first = [], [], [], 0
    for v, t, a in solids:
        vertices.append(torch.from_numpy(v))
        triangles.append(torch.from_numpy(t.astype(np.int64)) + first)
        albedo.append(torch.full((len(t),), a))
        first += len(v)
    return DiffuseScene(
        vertices=torch.cat(vertices), faces=torch.cat(triangles), albedo=torch.cat(albedo)
    )


if __name__ == "__main__":
    main()
