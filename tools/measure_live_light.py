"""How good, steady and quick the light of `skylight live` is, on rendered people.

    python -m tools.measure_live_light FOLDER --least-share 0.25 --estimates runs/estimates

FOLDER is one of ``skylight faces render --maps``. Of each face whose truth has a lamp of at least
so much of the light: the angle from the live direction to that lamp and to the main light of an
estimate, whether the lamp lies within the 90 % credible radius, and how much (root mean square) the
direction trembles while the picture moves by 2 % of its size, grows and shrinks by 3 %, with noise
of two codes. ``--estimates`` is a folder where estimates are kept between runs; without it there
are none. Times are the processor's, per frame, of one thread.
"""

import argparse
import math
import shlex
import statistics
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from numpy import ndarray

from skylight.errors import InputError
from skylight.estimation._photos import estimate_photo
from skylight.inverse._scores import find_lamps
from skylight.live import LiveLight
from skylight.people._files import read_rendered_face, rendered_faces
from skylight.sphere._envmap import EnvironmentMap
from tools.measured import kept, write_measured

FRAMES, RATE = 40, 15.0
SURE_DEG = 30.0


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--least-share", type=float, default=0.25)
    parser.add_argument("--estimates", type=Path)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/live-light.json"))
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    begun, rows = time.time(), []
    try:
        folders = rendered_faces(arguments.folder)
    except InputError as error:
        parser.error(str(error))
    for folder in folders:
        face = read_rendered_face(folder)
        lamps = find_lamps(face.environment)
        if lamps and lamps[0].share >= arguments.least_share:
            rows.append(measured(folder.name, face.encoded, lamps[0].direction.numpy()))
            if arguments.estimates is not None and "direction" in rows[-1]:
                add_estimate(rows[-1], face.encoded, arguments.estimates)
            print({name: x for name, x in rows[-1].items() if "direction" not in name}, flush=True)
    seen = [row for row in rows if "direction" in row]
    if not seen:
        parser.error(
            f"{arguments.folder}: no light was found for any of {len(rows)} faces whose truth has "
            f"a lamp of {arguments.least_share:g} of the light: render more, or lower --least-share"
        )
    sure = [row for row in seen if row["radius_90_deg"] <= SURE_DEG]
    facts: dict[str, object] = {"faces": len(rows), "with_light": len(seen), "sure": len(sure)}
    for among, name in ((seen, ""), (sure, "sure_")):
        for key in ("error_deg", "to_estimate_deg", "estimate_error_deg", "trembles_deg"):
            values = [row[key] for row in among if key in row]
            if values:
                facts[f"{name}{key}"] = statistics.median(values)
        if among:
            facts[f"{name}within"] = statistics.mean(row["within"] for row in among)
    facts["frame_ms"] = statistics.median(row["frame_ms"] for row in seen)
    command = ["python", "-m", "tools.measure_live_light", arguments.folder.name]
    command += ["--least-share", f"{arguments.least_share:g}"]
    if arguments.estimates is not None:
        command += ["--estimates", arguments.estimates.name]
    shares = f"lamps of {arguments.least_share:g} of the light and more"
    write_measured(
        arguments.out,
        name="live-light",
        what=f"{len(rows)} rendered people, {shares}; medians; sure: certain to {SURE_DEG:g} deg",
        command=shlex.join(command),
        begun=begun,
        facts=facts,
    )


def measured(
    name: str, picture: UInt8[ndarray, "h w 3"], lamp: Float[ndarray, "3"]
) -> dict[str, Any]:
    """Of a still picture, and of the same moved a little from frame to frame."""
    still = LiveLight()
    for k in range(3):
        light = still.update(picture, k / RATE)
    if light is None:
        return {"face": name}
    error = angle_deg(light.direction, lamp)
    moving, found = LiveLight(), []
    rng = np.random.default_rng(0)
    for k in range(FRAMES):
        frame = shifted(picture, k, rng)
        shown = moving.update(frame, k / RATE)
        if shown is not None:
            found.append(shown.direction)
    each_s = np.add(moving.timing.landmarks_s, moving.timing.light_s)[1:]  # the first fits a head
    settled = found[5:]
    apart = [angle_deg(one, np.mean(settled, axis=0)) for one in settled]
    trembles = math.sqrt(statistics.mean(x**2 for x in apart)) if apart else None
    return {
        "face": name,
        "direction": light.direction.tolist(),
        "error_deg": error,
        "radius_90_deg": math.degrees(light.radius_90_rad),
        "within": float(error <= math.degrees(light.radius_90_rad)),
        **({} if trembles is None else {"trembles_deg": trembles}),
        "frame_ms": 1000 * float(np.median(each_s)),
        "lamp_direction": lamp.tolist(),
    }


def shifted(
    picture: UInt8[ndarray, "h w 3"], k: int, rng: np.random.Generator
) -> UInt8[ndarray, "h w 3"]:
    height, width = picture.shape[:2]
    matrix = cv2.getRotationMatrix2D((width / 2, height / 2), 0.0, 1 + 0.03 * math.sin(k / 9))
    matrix[:, 2] += 0.02 * width * np.array([math.sin(k / 5), math.cos(k / 6)])
    moved = cv2.warpAffine(picture, matrix, (width, height), borderMode=cv2.BORDER_REPLICATE)
    return np.clip(moved + rng.normal(0, 2, moved.shape), 0, 255).astype(np.uint8)


def add_estimate(row: dict[str, Any], picture: UInt8[ndarray, "h w 3"], folder: Path) -> None:
    """The main light of an estimate of the same picture, by how maps' lamps are found."""

    def estimated() -> list[float]:
        environment: EnvironmentMap = estimate_photo(picture, workers=1).estimate.environment
        return find_lamps(environment, least_share=0.0)[0].direction.tolist()

    direction = np.array(kept(folder / f"{row['face']}.json", estimated))
    row["to_estimate_deg"] = angle_deg(np.array(row["direction"]), direction)
    row["estimate_error_deg"] = angle_deg(np.array(row["lamp_direction"]), direction)


def angle_deg(one: Float[ndarray, "3"], other: Float[ndarray, "3"]) -> float:
    cosine = one @ other / (np.linalg.norm(one) * np.linalg.norm(other))
    return math.degrees(math.acos(float(np.clip(cosine, -1, 1))))


if __name__ == "__main__":
    main()
