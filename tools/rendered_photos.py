"""Photographs of a printed probe on its pole over a marker board, rendered by Mitsuba.

With lens distortion, noise and sRGB codes of 8 bits, from poses that are known. Pictures that a
run left behind are used again.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8

from skylight.cli import main as skylight
from skylight.io._files import write_png
from skylight.people._independent_render import IndependentScene, Solid, as_photo
from skylight.probes.cameras._board import Board, save_board
from skylight.probes.cameras._drawing import lens_rays, looking_at
from skylight.probes.cameras._intrinsics import FLIP, Intrinsics
from skylight.probes.cameras._live import read_picture
from skylight.probes.cameras._pose import board_pose
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._rotation import RigidTransform
from skylight.transport._cameras import Camera
from skylight.transport._path_tracer import DiffuseScene

ALBEDO, BLACK, PAPER = 0.8, 0.04, 0.85
BOARD = Board(columns=7, rows=5, square_mm=25.0, marker_mm=18.0)
MARGIN_MM = 5.0
LENS = Intrinsics(
    width=1280, height=960, fx=1050.0, fy=1052.0, cx=634.0, cy=483.0,
    k1=-0.11, k2=0.06, p1=8e-4, p2=-5e-4,
)  # fmt: skip
NOISE = 1.5  # codes
_PER_MM = 8
_CALIBRATION = [  # tilts about x and z, degrees, distance, shift right and up, mm
    (0, 0, 330, 0, 0), (30, 0, 330, -40, 20), (-30, 5, 330, 40, -20), (0, 30, 350, 30, 20),
    (5, -30, 350, -30, -20), (25, 25, 380, 60, 30), (-25, -22, 380, -60, 40),
    (-20, 25, 300, -40, -40), (32, -20, 360, 70, -40), (10, 10, 280, 0, 10),
]  # fmt: skip
# azimuth and elevation in degrees, above and below the probe
VIEWS = [(a, 38.0) for a in range(0, 360, 45)] + [(a + 22.5, -16.0) for a in range(0, 360, 45)]


@dataclass(frozen=True, kw_only=True)
class Photographer:
    """``solids`` is all that stands there, board included; ``middle`` is the probe's, mm.

    ``samples`` for each pixel; ``name`` tells this set-up's pictures from another's.
    """

    work: Path
    name: str
    environment: EnvironmentMap
    solids: Sequence[Solid]
    middle: Float[np.ndarray, "3"]
    samples: int

    def __post_init__(self) -> None:
        self.work.mkdir(parents=True, exist_ok=True)
        key = self._key()
        told = self.work / "pictures.json"
        if told.exists() and told.read_text() != key:
            raise SystemExit(f"{self.work} has pictures of other settings: choose another --work")
        told.write_text(key)
        save_board(self.work / "board.json", BOARD)

    def _key(self) -> str:
        """All that the pictures depend on."""
        digest = hashlib.sha256(str((self.environment.radiance.sum(), NOISE, BOARD)).encode())
        for solid in self.solids:
            for values in (solid.vertices, solid.triangles, solid.albedo, solid.paint):
                digest.update(b"" if values is None else np.asarray(values).tobytes())
        poses = [self.pose(i) for i in range(len(VIEWS))]
        digest.update(np.stack([p.translation.numpy() for p in poses]).round(6).tobytes())
        return json.dumps(
            {
                "name": self.name,
                "samples": self.samples,
                "lens": asdict(LENS),
                "all": digest.hexdigest(),
            }
        )

    @property
    def exposure(self) -> float:
        """0.8 of a white face under the whole light is well below the codes' top."""
        grid = self.environment.grid
        level = float(self.environment.radiance.mean(-1).flatten() @ grid.solid_angles.float())
        return 0.55 / (ALBEDO * level / (4 * np.pi) * 1.6)

    @cached_property
    def scene(self) -> IndependentScene:
        return IndependentScene(self.solids, self.environment)

    @property
    def photos(self) -> list[Path]:
        return [self.work / f"probe_{i:02d}.png" for i in range(len(VIEWS))]

    @property
    def command_files(self) -> list[str]:
        """Camera and board, as the command line wants them."""
        return [
            "--camera",
            str(self.work / "camera.json"),
            "--board",
            str(self.work / "board.json"),
        ]

    def photograph(self) -> None:
        """Calibration pictures, and the probe from all sides."""
        flat = IndependentScene([board_solid()], self.environment)
        for i, view in enumerate(_CALIBRATION):
            path = self.work / f"calibration_{i:02d}.png"
            if not path.exists():  # those of a run that was stopped are kept
                write_png(path, self.photo(flat, _calibration_pose(*view), 16, i))
        for i, path in enumerate(self.photos):
            if not path.exists():
                write_png(path, self.photo(self.scene, self.pose(i), self.samples, 100 + i))
            print(f"photo {i + 1} of {len(VIEWS)}", flush=True)

    def calibrate(self) -> None:
        """By the command line, from the pictures of the board alone."""
        pictures = sorted(map(str, self.work.glob("calibration_*.png")))
        board = ["--board", str(self.work / "board.json")]
        run(["camera", "calibrate", *pictures, *board, "--out", str(self.work / "camera.json")])

    def pose(self, number: int) -> RigidTransform:
        """The true pose of a picture."""
        return self.pose_from(*VIEWS[number])

    def pose_from(self, azimuth_deg: float, elevation_deg: float) -> RigidTransform:
        """From above towards board and probe, or from below the probe."""
        azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
        flat = np.array([np.sin(azimuth), 0, np.cos(azimuth)]) * np.cos(elevation)
        towards = flat + np.array([0, np.sin(elevation), 0])
        above = elevation > 0
        # the probe and the board fill the picture's height
        target = self.middle - np.array([0, 80.0 if above else 95.0, 0])
        eye = self.middle + (420.0 if above else 370.0) * towards
        return looking_at(torch.from_numpy(eye), torch.from_numpy(target))

    def film(self, count: int) -> Path:
        """film_COUNT.avi, 640 x 480: once round below the probe, once round above it."""
        path = self.work / f"film_{count}.avi"
        if path.exists():
            return path
        code = cv2.VideoWriter.fourcc(*"MJPG")
        partial = self.work / "partial.avi"
        made = cv2.VideoWriter(str(partial), cv2.CAP_FFMPEG, code, 30.0, (640, 480))
        for i, pose in enumerate(self.film_poses(count)):
            frame = self.photo(self.scene, pose, self.samples, 1000 + i, lens=halved(LENS))
            made.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
            print(f"frame {i + 1} of {count}", flush=True)
        made.release()
        partial.rename(path)
        return path

    def film_poses(self, count: int) -> list[RigidTransform]:
        """The true poses of a film's frames."""
        half = -(-count // 2)
        return [
            self.pose_from(360 * (i % half) / half, -16.0 if i < half else 38.0)
            for i in range(count)
        ]

    def photo(
        self,
        scene: IndependentScene,
        pose: RigidTransform,
        samples: int,
        seed: int,
        lens: Intrinsics = LENS,
    ) -> UInt8[np.ndarray, "h w 3"]:
        """A picture as the camera gives it."""
        linear = bent_picture(scene, pose, samples, seed, lens)
        return as_photo(linear, exposure=self.exposure, noise=NOISE, seed=seed)

    def pose_errors(self, lens: Intrinsics) -> dict[str, object]:
        """Of the probe's middle in the camera's frame, mm, and of the rotation."""
        shifts, turns, missing = [], [], 0
        for i, path in enumerate(self.photos):
            found = board_pose(read_picture(path).image, BOARD, lens)
            if found is None or found.is_ambiguous:
                missing += 1
                continue
            true = self.pose(i)
            apart = found.pose.points(self.middle) - true.points(self.middle)
            shifts.append(float(np.linalg.norm(apart)))
            turns.append(float((found.pose @ true.inverse()).angle_deg))
        return {
            "focal_px": [lens.fx, lens.fy],
            "true_focal_px": [LENS.fx, LENS.fy],
            "poses_found": len(shifts),
            "poses_missing": missing,
            "pose_error_mm_median": float(np.median(shifts)),
            "pose_error_mm_max": max(shifts),
            "pose_error_deg_median": float(np.median(turns)),
            "pose_error_deg_max": max(turns),
        }


def bent_picture(
    scene: IndependentScene, pose: RigidTransform, samples: int, seed: int, lens: Intrinsics
) -> Float[np.ndarray, "h w 3"]:
    """Linear light, rendered by a pinhole with room around it, then bent as the lens does."""
    width, height = round(1.17 * lens.width), round(1.19 * lens.height)
    wide = Camera(focal_px=lens.fx, width=width, height=height, center_px=(width / 2, height / 2))
    linear = scene.radiance(
        wide, pose.rotation.numpy(), pose.translation.numpy(), samples=samples, seed=seed
    )
    rays = lens_rays(lens)[:, :, 0].numpy() @ FLIP
    x, y = (
        (rays[..., axis] / rays[..., 2] * wide.focal_px + wide.center_px[axis] - 0.5).astype(
            np.float32
        )
        for axis in (0, 1)
    )
    return cv2.remap(linear, x, y, cv2.INTER_LINEAR)


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


def run(arguments: list[str]) -> None:
    """`skylight` with these arguments."""
    if skylight(arguments) != 0:
        raise SystemExit(f"skylight {' '.join(arguments[:3])} failed")


def board_solid() -> Solid:
    """The printed paper with its margin, painted at 8 pixels a mm."""
    width, height = BOARD.size_mm
    m = MARGIN_MM
    shape = (round((height + 2 * m) * _PER_MM), round((width + 2 * m) * _PER_MM), 3)
    paint = np.full(shape, PAPER)
    for left, top, w, h in BOARD.dark_rectangles():
        rows = slice(round((top + m) * _PER_MM), round((top + m + h) * _PER_MM))
        columns = slice(round((left + m) * _PER_MM), round((left + m + w) * _PER_MM))
        paint[rows, columns] = BLACK
    corners = [(-m, -m), (width + m, -m), (width + m, height + m), (-m, height + m)]
    return Solid(
        vertices=np.array([(x, 0.0, z) for x, z in corners]),
        triangles=np.array([[0, 2, 1], [0, 3, 2]]),
        paint=paint,
        uv=np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]]),
    )


def as_diffuse_scene(solids: Sequence[Solid]) -> DiffuseScene:
    """For our own path tracer; what is painted has its mean albedo."""
    vertices, triangles, albedo, first = [], [], [], 0
    for solid in solids:
        mean = solid.albedo if solid.paint is None else float(solid.paint.mean())
        vertices.append(torch.from_numpy(solid.vertices))
        triangles.append(torch.from_numpy(solid.triangles.astype(np.int64)) + first)
        albedo.append(torch.full((len(solid.triangles),), mean))
        first += len(solid.vertices)
    return DiffuseScene(
        vertices=torch.cat(vertices), faces=torch.cat(triangles), albedo=torch.cat(albedo)
    )


def _calibration_pose(
    tilt_x: float, tilt_z: float, distance: float, right: float, up: float
) -> RigidTransform:
    """A camera above the board's middle, looking down, tilted and shifted."""
    width, height = BOARD.size_mm
    middle = np.array([width / 2, 0, height / 2])
    a, b = np.radians(90 - tilt_x), np.radians(tilt_z)
    offset = np.array([np.sin(b) * np.sin(a), np.sin(a) * np.cos(b), np.cos(a) + 1e-3])
    pose = looking_at(torch.from_numpy(middle + distance * offset), torch.from_numpy(middle))
    return RigidTransform.translating(torch.tensor([right, up, 0.0]).double()) @ pose
