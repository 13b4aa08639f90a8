"""Errors of landmarks on rendered people, which the fit of a head takes them to have.

    python tools/measure_landmarks.py --people DIR --out skylight/faces/data/mediapipe_landmarks.npz
    python tools/measure_landmarks.py --people DIR --landmarker dlib --out dlib_landmarks.npz
    python tools/measure_landmarks.py --compare 40

People (``tools/landmark_people.py``, kept in DIR) of all tones under lamps and skies of all kinds
have their landmarks detected, and compared with where those lie on the true heads. Errors are
strongly correlated, and they follow the light: with their second moment instead of independent
errors, the pose of held-out people is a third better.

MediaPipe's mesh: S = U U^T + diag over its fitted points, U the leading 120 modes; its mean error
is left in S, since what rendered heads and real people disagree about is not to be corrected by
rendered ones. iBUG's 68 points, as MediaPipe's stand for them: their mean error, to be taken off.
dlib's 68: S, shrunk by 30 % towards independence. ``--compare`` sets both landmarkers beside each
other on other people, or on the path-traced faces in ``--faces``.
"""

import argparse
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from skylight.evaluation._known_faces import pose_error_deg, synthetic_face
from skylight.faces._fit import FaceFit, camera_project, fit_face, landmarks_of
from skylight.faces._landmarkers import DlibLandmarker
from skylight.faces._landmarks import FaceLandmarker
from skylight.faces._mediapipe import IBUG, MediaPipeLandmarker, eye_axes
from skylight.faces._model import HeadModel
from skylight.io._atomic import atomic_path
from skylight.people._files import read_rendered_face, rendered_faces
from tools.landmark_people import Pictured, people

HELD_OUT_SEED, SEEDS_APART = 3_000_000, 1000  # of people to compare on
OUTLIER = 0.12  # median error, in eye distances, of a detection that is no detection
MODES, MESH_FLOOR = 120, 0.004
# Part of what is measured is the renderer's: painted brows, a cap of hair. dlib's correlations are
# shrunk towards independence, and every landmark gets 1 % of its own.
SHRINKAGE, FLOOR = 0.3, 0.01
INNER = slice(17, 68)

Truth = tuple[UInt8[ndarray, "h w 3"], Float[ndarray, "68 2"], FaceFit]  # picture, landmarks, head


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--landmarker", choices=("mediapipe", "dlib"), default="mediapipe")
    parser.add_argument("--people", type=Path, help="where the rendered people are kept")
    parser.add_argument("--count", type=int, default=1200)
    task = parser.add_mutually_exclusive_group(required=True)
    task.add_argument("--out", type=Path, help="measure, and write the errors there")
    task.add_argument("--compare", type=int, metavar="N", help="dlib with MediaPipe on N faces")
    parser.add_argument("--faces", type=Path, help="path-traced faces to compare on")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    if arguments.compare:
        count = arguments.compare
        faces = traced(arguments.faces, count) if arguments.faces else held_out(count)
        compare({"dlib": DlibLandmarker(), "mediapipe": MediaPipeLandmarker()}, faces)
        return
    if arguments.people is None:
        parser.error("--out needs --people FOLDER")
    measured = mediapipe_errors if arguments.landmarker == "mediapipe" else dlib_errors
    arrays = measured(people(arguments.people, arguments.count))
    print(f"{int(arrays['people'])} of {arguments.count} people used")
    with atomic_path(arguments.out) as path, path.open("wb") as stream:
        np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]


def mediapipe_errors(faces: Iterable[Pictured]) -> dict[str, ndarray]:
    """Modes, variances of their own, iBUG's mean error in units of ``eye_axes``."""
    landmarker, model = MediaPipeLandmarker(), HeadModel.load()
    mesh, ibug = [], []
    for face in faces:
        for seen in landmarker.faces(face.encoded)[:1]:
            points = seen.points
            head = face.truth
            shape = model.vertices(head.identity, head.expression)
            on_head = np.einsum("qc,qcd->qd", model.mesh_bary, shape[model.faces[model.mesh_faces]])
            true = camera_project(head.camera, on_head @ head.rotation.T + head.translation)
            axes = eye_axes(points)
            mesh.append((points[model.mesh_points] - true) / np.linalg.norm(axes[0]))
            gap = points[list(IBUG)] - landmarks_of(model, head)
            ibug.append(gap @ np.linalg.inv(axes))
    errors = np.array(mesh)
    kept = _plausible(errors)
    modes, own = low_rank(errors[kept].reshape(int(kept.sum()), -1), MODES)
    return {
        "modes": modes.astype(np.float32),
        "own": (own + MESH_FLOOR**2).astype(np.float32),
        "mean_error": np.array(ibug)[kept].mean(0).astype(np.float32),
        "people": np.asarray(kept.sum(), dtype=np.int64),
    }


def low_rank(
    errors: Float[ndarray, "n q"], rank: int
) -> tuple[Float[ndarray, "q r"], Float[ndarray, " q"]]:
    """U, d so that U U^T + diag(d) is about E^T E / n, and equal to it on the diagonal."""
    moment = errors.T @ errors / len(errors)
    values, vectors = np.linalg.eigh(moment)
    modes = vectors[:, -rank:] * np.sqrt(values[-rank:].clip(0))
    return modes, (np.diag(moment) - (modes**2).sum(1)).clip(0)


def dlib_errors(faces: Iterable[Pictured]) -> dict[str, ndarray]:
    """The second moment, in squared eye distances."""
    landmarker, model = DlibLandmarker(), HeadModel.load()
    errors = np.array(
        [
            (seen.points - landmarks_of(model, face.truth)) / seen.eye_distance_px
            for face in faces
            for seen in landmarker.detect(face.encoded)[:1]
        ]
    )
    kept = errors[_plausible(errors)].reshape(-1, 136)
    moment = kept.T @ kept / len(kept)
    shrunk = (1 - SHRINKAGE) * moment + SHRINKAGE * np.diag(np.diag(moment))
    return {
        "second_moment": (shrunk + FLOOR**2 * np.eye(136)).astype(np.float32),
        "people": np.asarray(len(kept), dtype=np.int64),
    }


def _plausible(errors: Float[ndarray, "n p 2"]) -> Bool[ndarray, " n"]:
    return np.median(np.linalg.norm(errors, axis=2), axis=1) < OUTLIER


def held_out(count: int) -> Iterator[Truth]:
    """People in the sun as those of ``skylight evaluate``, but others."""
    for i in range(count):
        face = synthetic_face(HELD_OUT_SEED + SEEDS_APART * i, 256)
        yield face.encoded, landmarks_of(HeadModel.load(), face.truth), face.truth


def traced(directory: Path, count: int) -> Iterator[Truth]:
    """Path-traced faces that ``skylight faces render`` wrote."""
    for folder in rendered_faces(directory)[:count]:
        face = read_rendered_face(folder)
        yield face.encoded, face.landmarks, face.truth


def compare(landmarkers: dict[str, FaceLandmarker], faces: Iterable[Truth]) -> None:
    """Print how both do; errors are of the faces that both find."""
    rows: dict[str, list[tuple[float, float, float] | None]] = {name: [] for name in landmarkers}
    for picture, truth, head in faces:
        for name, landmarker in landmarkers.items():
            rows[name].append(_errors_of(landmarker, picture, truth, head))
    both = [all(found) for found in zip(*rows.values(), strict=True)]
    print("landmarker    found     inner px   of eye distance   pose: mean, median (deg)")
    for name, found in rows.items():
        errors = np.array([row for row, both_find in zip(found, both, strict=True) if both_find])
        pixels, share, pose = errors.mean(0)
        print(
            f"{name:<12} {sum(map(bool, found)):>3}/{len(found):<3} {pixels:>11.2f} {share:>17.4f} "
            f"{pose:>15.2f} {np.median(errors[:, 2]):>8.2f}"
        )


def _errors_of(
    landmarker: FaceLandmarker,
    picture: UInt8[ndarray, "h w 3"],
    truth: Float[ndarray, "68 2"],
    head: FaceFit,
) -> tuple[float, float, float] | None:
    """(inner landmarks' mean error in pixels, the same in eye distances, pose error in degrees)."""
    found = landmarker.detect(picture)
    if not found:
        return None
    pixels = float(np.linalg.norm(found[0].points - truth, axis=1)[INNER].mean())
    eyes = float(np.linalg.norm(truth[45] - truth[36]))
    height, width = picture.shape[:2]
    fit = fit_face(HeadModel.load(), found[0], width, height)
    return pixels, pixels / eyes, pose_error_deg(fit, head)


if __name__ == "__main__":
    main()
