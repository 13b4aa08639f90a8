"""Heads with errors of known size, and smaller pictures (thesis, 5.5.5)."""

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
import torch
from scipy.spatial.transform import Rotation

from skylight.evaluation.faces.known_faces import KnownFace
from skylight.faces.fit import FaceFit, camera_project
from skylight.faces.model import HeadModel, Region
from skylight.transport.camera import Camera

Factor = Literal["size", "yaw", "pitch", "shape"]
_AXES = {"yaw": "y", "pitch": "x"}  # of the camera's frame: vertical, horizontal


@dataclass(frozen=True, kw_only=True)
class Condition:
    """One point of a curve: a picture's side in pixels, degrees, or standard deviations."""

    factor: Factor
    value: float

    @property
    def label(self) -> str:
        return f"{self.factor} {self.value:g}"


def perturbed(face: KnownFace, condition: Condition, noise_seed: int) -> KnownFace:
    """The face with its ``truth`` (or its picture) changed; its light stays."""
    if condition.factor == "size":
        return resampled(face, round(condition.value))
    if condition.factor == "shape":
        return replace(face, truth=misshapen(face.truth, condition.value, noise_seed))
    turned = turned_head(face.truth, _AXES[condition.factor], condition.value)
    return replace(face, truth=turned)


def turned_head(fit: FaceFit, axis: str, angle_deg: float) -> FaceFit:
    """The head turned about an axis of the camera's frame through its own centre.

    R' = P R, x' = P (x - t) + t with t where the centre of the head is: the centre stays where
    it was in the picture.
    """
    turn = Rotation.from_euler(axis, angle_deg, degrees=True).as_matrix()
    vertices = (fit.vertices - fit.translation) @ turn.T + fit.translation
    return replace(fit, rotation=turn @ fit.rotation, vertices=vertices)


def misshapen(fit: FaceFit, sigma: float, seed: int) -> FaceFit:
    """``sigma`` times standard normal noise on every identity and expression coefficient.

    One ``seed`` gives one direction of error, which grows with sigma.
    """
    rng = np.random.default_rng(seed)
    identity = fit.identity + sigma * rng.standard_normal(len(fit.identity))
    expression = fit.expression + sigma * rng.standard_normal(len(fit.expression))
    shape = HeadModel.load().vertices(identity, expression)
    return replace(
        fit,
        identity=identity,
        expression=expression,
        vertices=shape @ fit.rotation.T + fit.translation,
    )


def resampled(face: KnownFace, side: int) -> KnownFace:
    """The (square) picture as one of ``side`` x ``side`` pixels, by area; its camera with it."""
    camera = face.truth.camera
    ratio = side / camera.width
    small = cv2.resize(face.picture.numpy(), (side, side), interpolation=cv2.INTER_AREA)
    share = cv2.resize(
        face.clipped.numpy().astype(np.float32), (side, side), interpolation=cv2.INTER_AREA
    )
    encoded = cv2.resize(face.encoded, (side, side), interpolation=cv2.INTER_AREA)
    scaled = Camera(
        focal_px=camera.focal_px * ratio,
        width=side,
        height=side,
        center_px=(camera.center_px[0] * ratio, camera.center_px[1] * ratio),
    )
    return replace(
        face,
        encoded=encoded,
        picture=torch.from_numpy(small),
        clipped=torch.from_numpy(share > 0),
        truth=replace(face.truth, camera=scaled),
    )


def face_height_px(fit: FaceFit) -> int:
    """How many pixels high the skin of the face is in its picture."""
    skin = HeadModel.load().regions == Region.FACE
    return round(float(np.ptp(camera_project(fit.camera, fit.vertices[skin])[:, 1])))
