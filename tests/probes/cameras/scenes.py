"""Pictures of boards and boxes by cameras that are known exactly, without the code under test."""

from functools import lru_cache

import cv2
import numpy as np
import torch

from skylight.imaging._colour import linear_to_srgb
from skylight.probes.cameras._board import Board
from skylight.probes.cameras._intrinsics import Intrinsics

LENS = Intrinsics(
    width=960, height=720, fx=900.0, fy=905.0, cx=470.0, cy=365.0,
    k1=-0.12, k2=0.08, p1=0.0008, p2=-0.0006,
)  # fmt: skip
_FINER = 2  # samples a pixel and axis
_MARGIN_MM = 30.0


def board_from_tilt(
    board: Board, tilt_x_deg: float, tilt_y_deg: float, turn_deg: float, centre_mm: list[float]
) -> tuple[np.ndarray, np.ndarray]:
    """(R, t) of OpenCV's board frame in OpenCV's camera frame; the board's middle is placed."""
    turns = [
        cv2.Rodrigues(np.radians(angle) * np.eye(3)[axis])[0]
        for axis, angle in ((0, tilt_x_deg), (1, tilt_y_deg), (2, turn_deg))
    ]
    rotation = turns[0] @ turns[1] @ turns[2]
    middle = np.array([board.size_mm[0] / 2, board.size_mm[1] / 2, 0.0])
    return rotation, np.array(centre_mm) - rotation @ middle


def picture_of_board(
    board: Board,
    lens: Intrinsics,
    rotation: np.ndarray,
    translation: np.ndarray,
    *,
    noise: float = 2.0,
    seed: int = 0,
) -> np.ndarray:
    """RGB codes of the board on white paper before a grey wall, with Gaussian noise."""
    per_mm = 6.0
    width, height = board.size_mm
    pixels = (round(width * per_mm), round(height * per_mm))
    pattern = board.charuco().generateImage(pixels, marginSize=0)
    texture = cv2.copyMakeBorder(
        pattern, *[round(_MARGIN_MM * per_mm)] * 4, cv2.BORDER_CONSTANT, value=[255]
    )
    rays = rays_through(lens)
    # H = (r1 r2 t) takes the board's (x, y, 1) to rays
    plane = np.linalg.inv(np.stack([rotation[:, 0], rotation[:, 1], translation], 1))
    to_texture = np.array([[per_mm, 0, m := per_mm * _MARGIN_MM - 0.5], [0, per_mm, m], [0, 0, 1]])
    at = rays.astype(np.float32) @ (to_texture @ plane).T.astype(np.float32)
    where = np.where(at[:, 2:] > 0, at[:, :2] / at[:, 2:], np.float32(-1e6))
    shape = (lens.height * _FINER, lens.width * _FINER)
    seen = cv2.remap(
        texture, where[:, 0].reshape(shape), where[:, 1].reshape(shape), cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT, borderValue=[110],
    )  # fmt: skip
    return codes(40 + 170 * shrink(seen) / 255, noise=noise, seed=seed)


def picture_of_box(
    lens: Intrinsics,
    rotation: np.ndarray,
    translation: np.ndarray,
    *,
    side_mm: float,
    noise: float = 2.0,
    seed: int = 0,
) -> np.ndarray:
    """A cube [0, side]^3 with a brightness of its own for each pair of sides, ray by ray."""
    rays = rays_through(lens) @ rotation
    start = -rotation.T @ translation
    with np.errstate(divide="ignore"):
        a, b = (0 - start) / rays, (side_mm - start) / rays
    near, far = np.minimum(a, b), np.maximum(a, b)
    enter, axis = near.max(1), near.argmax(1)
    hit = (enter < far.min(1)) & (enter > 0)
    shade = np.where(hit, np.array([90.0, 200.0, 140.0])[axis], 30.0)
    shape = (lens.height * _FINER, lens.width * _FINER)
    return codes(shrink(shade.reshape(shape)), noise=noise, seed=seed)


@lru_cache(maxsize=2)
def rays_through(lens: Intrinsics) -> np.ndarray:
    """Directions with z = 1 through all samples, in OpenCV's frame."""
    y, x = np.meshgrid(
        (np.arange(lens.height * _FINER) + 0.5) / _FINER - 0.5,
        (np.arange(lens.width * _FINER) + 0.5) / _FINER - 0.5,
        indexing="ij",
    )
    distorted = np.stack([x.ravel() - lens.cx, y.ravel() - lens.cy], 1) / [lens.fx, lens.fy]
    plain = distorted.copy()
    for _ in range(8):  # fixed-point inversion: slow, and another way than the package's
        u, v = plain.T
        r2 = u * u + v * v
        radial = 1 + lens.k1 * r2 + lens.k2 * r2**2 + lens.k3 * r2**3
        skew = np.stack(
            [
                2 * lens.p1 * u * v + lens.p2 * (r2 + 2 * u * u),
                lens.p1 * (r2 + 2 * v * v) + 2 * lens.p2 * u * v,
            ],
            1,
        )
        plain = (distorted - skew) / radial[:, None]
    return np.concatenate([plain, np.ones((len(plain), 1))], 1)


def shrink(fine: np.ndarray) -> np.ndarray:
    height, width = fine.shape
    blocks = fine.astype(np.float64).reshape(height // _FINER, _FINER, width // _FINER, _FINER)
    return blocks.mean((1, 3))


def codes(grey: np.ndarray, *, noise: float, seed: int) -> np.ndarray:
    noisy = grey[..., None] + noise * np.random.default_rng(seed).standard_normal((*grey.shape, 3))
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def srgb(light: np.ndarray) -> np.ndarray:
    return linear_to_srgb(torch.from_numpy(light)).numpy()


def film(light: np.ndarray) -> np.ndarray:
    """An S-shaped curve as cameras' picture styles have."""
    share = light ** (1 / 2.4)
    return share + 0.06 * np.sin(2 * np.pi * (share - 0.5))
