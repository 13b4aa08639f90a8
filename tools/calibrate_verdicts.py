"""Check skylight.inverse._verdict: how often each word holds on rendered people.

    python tools/calibrate_verdicts.py PEOPLE [MORE ...] --light sphere --cache verdicts

Each is a folder of ``skylight faces render``, under simulated skies or places: nothing is tuned on
captured maps. Their backgrounds count as in photographs. A face takes some ten seconds; what came
of it is kept in --cache, by folder and light, so that a run that was stopped goes on: give another
one when the code has changed. Those in whom no face is found are kept too. For each word it prints
of how many faces, and of how many the error is what the word says at most: 10 degrees to the main
light, which holds a third of all light (the sun where it shows), factors of the map's mean
luminance and of its mean red and blue over green. "Sure" is to hold for 85 to 95 %. Then k of the
module's text is what makes 90 % of the errors lie within exp(1.645 s), for the floor e as it is.
"""

import argparse
import json
import math
from pathlib import Path

import numpy as np
import torch

from skylight.errors import InputError
from skylight.evaluation._known_faces import KnownFace, fitted_head, light_of, read_face
from skylight.inverse._result import Estimate
from skylight.inverse._scores import find_lamps
from skylight.inverse._verdict import LEVEL_FLOOR, TINT_FLOOR
from skylight.io._bounded import write_json
from skylight.people._files import rendered_faces
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import angle_between

MAIN_SHARE = 1 / 3
MOST_DEG = 10.0
Case = dict[str, float | str | None]


def case(face: KnownFace, found: Estimate) -> Case:
    """What is said of one face, and what is true."""
    verdict, faces = found.verdict, found.faces
    main = main_direction(face)
    off = None if main is None else float(angle_between(found.sun_direction.double(), main))
    error = (told(found.environment) - told(face.environment)).abs()
    return {
        **{name: getattr(verdict, name).word for name in ("direction", *SPREADS)},
        "summary": verdict.summary,
        "direction_error": None if off is None else math.degrees(off),
        "direction_most": MOST_DEG,
        "brightness_error": math.exp(float(error[0])),
        "brightness_most": verdict.brightness.within,
        "brightness_spread": found.spreads.level,
        "colour_error": math.exp(float(error[1:].max())),
        "colour_most": verdict.colour.within,
        "colour_spread": found.spreads.tint,
        "residual": max(one.residual for one in faces),
        "misplaced": max(one.misplaced for one in faces),
    }


SPREADS = {"brightness": LEVEL_FLOOR, "colour": TINT_FLOOR}


def main_direction(face: KnownFace) -> torch.Tensor | None:
    """The sun's where it shows, else that of the lamp with enough of the light."""
    if face.sun_visible:
        return face.environment.brightest_direction().double()
    lamps = find_lamps(face.environment)
    return lamps[0].direction.double() if lamps and lamps[0].share > MAIN_SHARE else None


def told(light: EnvironmentMap) -> torch.Tensor:
    """Log of the map's mean luminance, and of its mean red and blue over green."""
    whole = light.integrate().double()
    red, green, blue = whole.log().tolist()
    return torch.tensor([float(luminance(whole).log()), red - green, blue - green])


def report(name: str, cases: list[Case]) -> None:
    """Of each word, how many and how many of them hold."""
    for word in ("sure", "rough", "unknown"):
        those = [one for one in cases if one[name] == word and one[f"{name}_error"] is not None]
        held = [float(one[f"{name}_error"]) <= float(one[f"{name}_most"]) for one in those]  # type: ignore[arg-type]
        share = f", {100 * np.mean(held):.0f} % hold" if held else ""
        print(f"{name:<11}{word:<8}{len(those):4} of {len(cases)}{share}")


def scale_of(name: str, cases: list[Case]) -> float:
    """k: errors are within exp(1.645 (k^2 s^2 + e^2)^(1/2)) for 90 %."""
    errors = np.log([float(one[f"{name}_error"]) for one in cases]) / 1.645  # type: ignore[arg-type]
    spreads = np.array([float(one[f"{name}_spread"]) for one in cases])  # type: ignore[arg-type]
    rest = np.sqrt(np.maximum(errors**2 - SPREADS[name] ** 2, 0))
    return float(np.quantile(rest / spreads, 0.9))


def main() -> None:
    parser = argparse.ArgumentParser(description="How often the words of a verdict hold.")
    parser.add_argument("people", type=Path, nargs="+")
    parser.add_argument("--light", default="sphere")
    parser.add_argument("--cache", type=Path, required=True)
    options = parser.parse_args()
    options.cache.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    cases: list[Case] = []
    for folder in (folder for people in options.people for folder in rendered_faces(people)):
        path = options.cache / f"{folder.parent.name}-{folder.name}-{options.light}.json"
        if not path.exists():
            face = read_face(folder)
            try:
                found = light_of(face, fitted_head(face, {}), (options.light,), {})
                told = case(face, found.estimates[options.light])
            except InputError:  # no face is found
                told = None
            write_json(path, told)
        if (kept := json.loads(path.read_text())) is not None:
            cases.append(kept)
    explained = [one for one in cases if not str(one["summary"]).startswith("unreliable")]
    print(f"unreliable {len(cases) - len(explained)} of {len(cases)}")
    for name in ("direction", *SPREADS):
        report(name, explained)
    for name in SPREADS:
        print(f"k of {name} {scale_of(name, explained):.2f}")


if __name__ == "__main__":
    main()
