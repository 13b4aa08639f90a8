"""How steady the light of films is against that of their frames, and what a keyframe costs.

    python -m tools.measure_films --films 3 --frames 24 --folder runs/films

Goes on where it was stopped; what is measured of a film is kept beside it.

Renders path-traced films (:mod:`skylight.people._film`) whose sun stands still
while head and camera turn, where they are not in the folder yet, estimates the light of each film
and of some of its frames alone, and compares both in the world's frame. Single frames are turned
by the true turns of the camera, films by those that were found.

``..._scatter_deg`` is the median angle between a direction and its mean over the film: of the sun,
and of the sky's luminance (its mean direction). ``..._error_deg`` is against the true sun. Medians
over films. ``keyframe_s`` is processor time of one more keyframe, of all threads and processes: of
the whole film but for its start, over the keyframes. ``frame_s`` is that of one more frame that
is followed only.
"""

import argparse
import os
import shutil
import statistics
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch

from skylight.errors import InputError
from skylight.estimation._photos import estimate_photo
from skylight.estimation._settings import EstimateSettings
from skylight.estimation.film._estimate import (
    FilmEstimate,
    FilmSettings,
    estimate_film,
    followed_film,
)
from skylight.estimation.film._light import SHARE_OF_START
from skylight.io._atomic import atomic_path
from skylight.io._files import write_png
from skylight.people._film import FilmTruth, film_frame, film_truth
from skylight.people._light import RenderOptions
from skylight.sphere._envmap import EnvironmentMap
from tools.measured import kept, write_measured

RATE = 8.0  # frames a second


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--films", type=int, default=3)
    parser.add_argument("--frames", type=int, default=24)
    parser.add_argument("--every", type=int, default=3, help="frames that are estimated alone")
    parser.add_argument("--folder", type=Path, default=Path("runs/films"))
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/films.json"))
    arguments = parser.parse_args()
    begun = time.time()
    options = RenderOptions(size=288, samples=32, seed=7, sunny=True)
    rows = []
    for number in range(arguments.films):
        folder = arguments.folder / f"film{number}"
        render(folder, number, arguments.frames, options)
        truth = film_truth(number, arguments.frames, options)
        path = arguments.folder / f"film{number}.json"
        rows.append(kept(path, partial(measure, folder, truth, arguments.every)))
        print(f"film {number}: {rows[-1]}", flush=True)
    facts = {name: statistics.median(row[name] for row in rows) for name in rows[0]}
    write_measured(
        arguments.out,
        name="films",
        what=f"{arguments.films} path-traced films of {arguments.frames} frames, 288 px, sun at "
        "rest; head turned by 28 degrees, camera by 15 to either side",
        command=f"python -m tools.measure_films --films {arguments.films} --frames "
        f"{arguments.frames}",
        begun=begun,
        facts=facts,
    )


def render(folder: Path, number: int, frames: int, options: RenderOptions) -> None:
    """The frames that are not there yet."""
    folder.mkdir(parents=True, exist_ok=True)
    for frame in range(frames):
        path = folder / f"{frame:03d}.png"
        if not path.exists():
            with atomic_path(path) as temporary:
                write_png(temporary, film_frame(number, frame, frames, options))


@dataclass(frozen=True)
class Directions:
    """Of the sun and of the sky's luminance in the world, (n,3) each."""

    sun: np.ndarray
    sky: np.ndarray


def measure(folder: Path, truth: FilmTruth, every: int) -> dict[str, float]:
    count = len(truth.exposures)
    clock = _Clock()
    film = estimated(folder, truth, count, clock)
    begun = _processor_s()
    single = FilmSettings(estimate=EstimateSettings(device="cpu"), rate=RATE, keyframes=1)
    followed_film(folder, _emptied(folder, 1), single)
    followed_s = _processor_s() - begun
    assert truth.light.sun is not None
    sun = truth.light.sun.numpy()
    together = Directions(
        sun=np.array([frame.sun_direction.numpy() for frame in film.light.frames]),
        sky=np.array([_sky(frame.environment, np.eye(3)) for frame in film.light.frames]),
    )
    alone = singles(folder, truth, every)
    turns = [truth.world_from_camera[one.number] for one in film.keyframes]
    camera = [_angle_deg(a, b) for a, b in zip(film.world_from_camera, turns, strict=True)]
    facts = {
        "frames_sun_scatter_deg": _scatter_deg(alone.sun),
        "film_sun_scatter_deg": _scatter_deg(together.sun),
        "frames_sky_scatter_deg": _scatter_deg(alone.sky),
        "film_sky_scatter_deg": _scatter_deg(together.sky),
        "frames_sun_error_deg": float(np.median(_degrees(alone.sun, sun))),
        "film_sun_error_deg": float(_degrees(film.light.mean.sun_direction.numpy()[None], sun)[0]),
        "camera_turn_error_deg": float(np.median(camera)),
        "focal_length_error": abs(film.fits[0].camera.focal_px / truth.focal_px - 1),
        "drift_per_s": film.light.drift_per_s,
        "noise": film.light.noise,
        "film_s": clock.seconds["all"],
        "keyframe_s": (clock.seconds["all"] - clock.seconds["start"]) / count,
        "frame_s": followed_s / count,
    }
    facts["sun_steadier_by"] = facts["frames_sun_scatter_deg"] / facts["film_sun_scatter_deg"]
    facts["sky_steadier_by"] = facts["frames_sky_scatter_deg"] / facts["film_sky_scatter_deg"]
    return facts


class _Clock:
    """Processor time of all of an estimate, and of the start of its light."""

    def __init__(self) -> None:
        self.begun = self.light_begun = _processor_s()
        self.seconds: dict[str, float] = {}

    def __call__(self, stage: str, share: float) -> None:
        now = _processor_s()
        if stage == "tracing light":
            self.light_begun = now
        elif stage == "estimating the light" and share <= SHARE_OF_START:
            self.seconds["start"] = now - self.light_begun
        self.seconds["all"] = now - self.begun


def _emptied(folder: Path, keyframes: int) -> Path:
    """Where results go, without those of earlier runs: the time of all of it counts."""
    out = folder.with_name(f"{folder.name}_light_{keyframes}")
    shutil.rmtree(out, ignore_errors=True)
    return out


def estimated(folder: Path, truth: FilmTruth, keyframes: int, clock: _Clock) -> FilmEstimate:
    on_cpu = EstimateSettings(device="cpu")
    settings = FilmSettings(estimate=on_cpu, rate=RATE, keyframes=keyframes)
    return estimate_film(folder, _emptied(folder, keyframes), settings, clock)


def singles(folder: Path, truth: FilmTruth, every: int) -> Directions:
    """Frames as photographs, turned into the world."""
    path = folder.with_name(f"{folder.name}_frames_{every}.npz")
    if path.exists():
        with np.load(path) as stored:
            return Directions(sun=stored["sun"], sky=stored["sky"])
    suns, skies = [], []
    for k in range(0, len(truth.exposures), every):
        turn = truth.world_from_camera[k]
        try:
            found = estimate_photo(folder / f"{k:03d}.png", device="cpu").estimate
        except InputError as error:
            print(f"left out: {error}", flush=True)
            continue
        suns.append(turn @ found.sun_direction.numpy())
        skies.append(_sky(found.environment, turn))
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez(file, sun=np.array(suns), sky=np.array(skies))
    return Directions(sun=np.array(suns), sky=np.array(skies))


def _sky(environment: EnvironmentMap, turn: np.ndarray) -> np.ndarray:
    return turn @ environment.mean_direction().double().numpy()


def _scatter_deg(directions: np.ndarray) -> float:
    mean = directions.mean(0)
    return float(np.median(_degrees(directions, mean / np.linalg.norm(mean))))


def _degrees(directions: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos(np.clip(directions @ other, -1, 1)))


def _angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip((np.trace(a.T @ b) - 1) / 2, -1, 1))))


def _processor_s() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


if __name__ == "__main__":
    torch.set_num_threads(1)
    main()
