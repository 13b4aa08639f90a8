"""What bending the fitted head to meet its landmarks does to the light that is found.

    python -m tools.measure_heads --lamps ../shared/data/lamps --rendered 60

The largest face of each photograph of a folder under one known lamp, and people rendered on the
spot under the sun: the autoencoder's light with the fitted head and with the deformed one (thesis,
bounded biharmonic weights). Angles to the lamp or sun, and the paired difference with its standard
error.
"""

import argparse
import math
import time
from collections.abc import Iterable
from pathlib import Path
from typing import get_args

import numpy as np
import torch

from skylight.errors import InputError
from skylight.evaluation._known_faces import FaceSource
from skylight.evaluation._lamps import INDEX, read_lamp_photo
from skylight.evaluation._run import read_index
from skylight.faces._fit import fit_visible
from skylight.faces._landmarkers import choose_landmarker
from skylight.faces._model import HeadModel
from skylight.faces._names import HeadName
from skylight.faces._observe import observe_face
from skylight.imaging._photo import Photo, photo_from_codes
from skylight.inverse._estimate import estimate_light
from skylight.sphere._frame import angle_between
from skylight.work._resumable import share_work
from tools.measured import write_measured

HEADS: tuple[HeadName, ...] = get_args(HeadName)

Angles = dict[HeadName, float]  # degrees between the light found and the true one


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--lamps", type=Path)
    parser.add_argument("--rendered", type=int, default=60)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/heads.json"))
    arguments = parser.parse_args()
    begun = time.time()
    facts = {}
    if arguments.lamps is not None:
        index = read_index(arguments.lamps / INDEX)
        work = [(arguments.lamps / name, tuple(lamp)) for name, lamp in sorted(index.items())]
        in_front = [piece for piece in work if piece[1][2] >= 0]
        facts["lamps"] = _paired(share_work(under_lamp, in_front, workers=arguments.workers))
    names = [(name,) for name in _people(arguments.rendered).names()]
    facts["rendered"] = _paired(share_work(under_sun, names, workers=arguments.workers))
    lamps = "" if arguments.lamps is None else f"--lamps {arguments.lamps.name} "
    write_measured(
        arguments.out,
        name="heads",
        what="The light found with the fitted head, and with that head bent to meet its landmarks",
        command=f"python -m tools.measure_heads {lamps}--rendered {arguments.rendered}",
        begun=begun,
        facts=facts,
    )


def _people(count: int) -> FaceSource:
    return FaceSource(data=None, count=count)


def under_lamp(path: Path, lamp: tuple[float, float, float]) -> Angles | None:
    return _found(read_lamp_photo(path), torch.tensor(lamp, dtype=torch.float64))


def under_sun(name: str) -> Angles | None:
    face = _people(0).read(name)
    return _found(photo_from_codes(face.encoded), face.environment.brightest_direction())


def _found(photo: Photo, light: torch.Tensor) -> Angles | None:
    """None where a face is not found or cannot be used."""
    model, angles = HeadModel.load(), {}
    faces = choose_landmarker().detect(photo.encoded)
    if not faces:
        return None
    for head in HEADS:
        try:
            fit = fit_visible(model, photo, faces[0], "the face", head)
            view = observe_face(photo.pixels, photo.clipped, model, fit)
        except InputError:
            return None
        estimate = estimate_light(view.observation, "autoencoder")
        to_light = angle_between(estimate.sun_direction.double(), light.double())
        angles[head] = math.degrees(float(to_light))
    return angles


def _paired(results: Iterable[Angles | None]) -> dict[str, object]:
    there = [one for one in results if one is not None]
    angles = {head: np.array([one[head] for one in there]) for head in HEADS}
    facts: dict[str, object] = {"faces": len(there)}
    for head in HEADS:
        facts[head] = {
            "angle_mean_deg": float(angles[head].mean()),
            "angle_median_deg": float(np.median(angles[head])),
        }
    first, second = HEADS
    more = angles[second] - angles[first]
    facts[f"{second}_less_{first}_deg"] = float(more.mean())
    facts["standard_error_deg"] = float(more.std(ddof=1) / math.sqrt(len(more)))
    return facts


if __name__ == "__main__":
    main()
