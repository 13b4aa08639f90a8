"""Mean and covariance of the errors of a landmark detector.

    python tools/measure_landmarks.py --out skylight/faces/data/mediapipe_landmarks.npz
    python tools/measure_landmarks.py --landmarker dlib --out skylight/faces/data/dlib_landmarks.npz
    python tools/measure_landmarks.py --compare 40

Renders random people under simulated training skies, detects their landmarks, and compares them
with the projected landmarks of the true heads (the jaw's on the silhouette). The errors are large
along the jaw and the brows and strongly correlated, and the fit needs to know it: with dlib's
second moment instead of independent errors, the head's pose comes out a sixth better on held-out
people. MediaPipe's points are not defined as iBUG's are: their mean error is stored too, to be
taken off. ``--compare`` sets both landmarkers beside each other on other people, or on the
path-traced faces in ``--faces``.
"""

import argparse
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from skylight.evaluation.faces.face_light import pose_error_deg
from skylight.evaluation.faces.known_faces import synthetic_face
from skylight.evaluation.rendered_faces.files import read_rendered_face, rendered_faces
from skylight.faces.dlib_landmarks import DlibLandmarker
from skylight.faces.fit import FaceFit, FitProblem, fit_face
from skylight.faces.landmarks import DetectedFace, FaceLandmarker
from skylight.faces.mediapipe_face import IBUG, MediaPipeLandmarker, eye_axes
from skylight.faces.model import HeadModel
from skylight.faces.synthetic import render_face
from skylight.io.atomic import atomic_path
from skylight.skies.simulated import simulated_skies

SKIES = 40
FIRST_SKY_SEED = 9_000_000  # beyond those that evaluations draw their skies from
FIRST_PERSON_SEED = 1_000_000
HELD_OUT_SEED, SEEDS_APART = 3_000_000, 1000  # of people to compare on
OUTLIER = 0.12  # median error, in eye distances, of a detection that is no detection
# Part of what is measured is the renderer's: bald people with painted brows. Correlations are
# shrunk towards independence, and every landmark gets 1 % of its own.
SHRINKAGE, FLOOR = 0.3, 0.01
INNER = slice(17, 68)

Truth = tuple[UInt8[ndarray, "h w 3"], Float[ndarray, "68 2"], FaceFit]  # picture, landmarks, head


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--landmarker", choices=("mediapipe", "dlib"), default="mediapipe")
    parser.add_argument("--people", type=int, default=400)
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
    faces = people(arguments.people)
    if arguments.landmarker == "dlib":
        errors, mean = dlib_errors(DlibLandmarker(), faces), np.zeros((68, 2))
    else:
        errors, mean = mediapipe_errors(MediaPipeLandmarker(), faces)
    kept = errors[_plausible(errors)].reshape(-1, 136)
    print(f"{len(errors)} of {arguments.people} people found, {len(kept)} used")
    moment = kept.T @ kept / len(kept)
    moment = (
        (1 - SHRINKAGE) * moment + SHRINKAGE * np.diag(np.diag(moment)) + FLOOR**2 * np.eye(136)
    )
    with atomic_path(arguments.out) as path, path.open("wb") as stream:
        np.savez_compressed(
            stream,
            second_moment=moment.astype(np.float32),
            mean_error=mean.astype(np.float32),  # what is taken off first
            people=np.asarray(len(kept), dtype=np.int64),
        )


def people(count: int) -> Iterator[Truth]:
    """Random people under skies of all kinds."""
    # 8 rows of light, 32 where it is bright, are enough to make landmarks err as they do
    skies = [sky.resize(4) for _, sky in simulated_skies(SKIES, first_seed=FIRST_SKY_SEED)]
    ground = torch.tensor([0.14, 0.13, 0.12])
    for i in range(count):
        face = render_face(skies[i % SKIES], ground, seed=FIRST_PERSON_SEED + i, light_rows=32)
        yield face.encoded, FitProblem.landmarks_of(HeadModel.load(), face.truth), face.truth
        if (i + 1) % 20 == 0:
            print(f"{i + 1} of {count} people", flush=True)


def held_out(count: int) -> Iterator[Truth]:
    """People in the sun as those of ``skylight evaluate``, but others."""
    for i in range(count):
        face = synthetic_face(HELD_OUT_SEED + SEEDS_APART * i, 256)
        yield face.encoded, FitProblem.landmarks_of(HeadModel.load(), face.truth), face.truth


def traced(directory: Path, count: int) -> Iterator[Truth]:
    """Path-traced faces that ``skylight faces render`` wrote."""
    for folder in rendered_faces(directory)[:count]:
        face = read_rendered_face(folder)
        yield face.encoded, face.landmarks, face.truth


def dlib_errors(landmarker: DlibLandmarker, faces: Iterable[Truth]) -> Float[ndarray, "n 68 2"]:
    """Errors in eye distances, of the people found."""
    errors = []
    for picture, truth, _ in faces:
        errors += [_in_eyes(found, truth) for found in landmarker.detect(picture)[:1]]
    return np.array(errors)


def mediapipe_errors(
    landmarker: MediaPipeLandmarker, faces: Iterable[Truth]
) -> tuple[Float[ndarray, "n 68 2"], Float[ndarray, "68 2"]]:
    """(errors in eye distances once the mean is off, the mean in units of ``eye_axes``)."""
    read = [
        (points, truth)
        for picture, truth, _ in faces
        for points, _ in landmarker.faces(picture)[:1]
    ]
    gaps = np.array(
        [(points[list(IBUG)] - truth) @ np.linalg.inv(eye_axes(points)) for points, truth in read]
    )
    mean = gaps[_plausible(gaps)].mean(0)
    corrected = [points[list(IBUG)] - mean @ eye_axes(points) for points, _ in read]
    errors = [
        _in_eyes(DetectedFace(points=points, score=1.0), truth)
        for points, (_, truth) in zip(corrected, read, strict=True)
    ]
    return np.array(errors), mean


def _in_eyes(face: DetectedFace, truth: Float[ndarray, "68 2"]) -> Float[ndarray, "68 2"]:
    return (face.points - truth) / face.eye_distance_px


def _plausible(errors: Float[ndarray, "n 68 2"]) -> Bool[ndarray, " n"]:
    return np.median(np.linalg.norm(errors, axis=2), axis=1) < OUTLIER


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
