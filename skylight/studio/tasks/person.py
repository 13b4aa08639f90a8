"""Of an estimate, what its person can be taken apart from later, without estimating again."""

import json
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor

from skylight.app.estimate.types import PhotoEstimate
from skylight.app.portrait.lights import MovableSun
from skylight.app.portrait.relit import warning_of
from skylight.faces.fit import FaceFit
from skylight.inverse.portrait.photograph import FaceReflection, light_in_photo
from skylight.io.tensors import read_tensors, write_tensors
from skylight.models.names import LightName
from skylight.sphere.envmap import EnvironmentMap, luminance
from skylight.transport.camera import Camera

KEPT = "person.safetensors"
_OF_FIT = ("rotation", "translation", "identity", "expression", "vertices")


@dataclass(frozen=True, kw_only=True)
class KeptPerson:
    """The (first) face of an estimate; ``found`` and ``sun`` are in its photograph's units.

    ``facts`` are for the page: ``command``, the words of a command line up to its sun;
    ``is_alone``, whether the light is that of this face only; ``is_lamp``; ``was_found``;
    ``strength``, the sun's luminance as a multiple of the rest's on a horizontal surface, None
    where that is black; ``warning``.
    """

    fit: FaceFit
    reflection: FaceReflection
    found: EnvironmentMap
    sun: MovableSun
    facts: dict[str, Any]


def command_of(
    name: str, light: LightName, face: int | Literal["all"], model: str | None
) -> dict[str, Any]:
    """``command`` and ``is_alone`` of :class:`KeptPerson`."""
    words = ["skylight", "relight-portrait", name, "--light", light]
    words += [] if face in (1, "all") else ["--face", str(face)]
    words += [] if model is None else ["--model", model]
    return {"command": shlex.join(words), "is_alone": face != "all"}


def keep_person(folder: Path, result: PhotoEstimate, command: dict[str, Any]) -> None:
    """Write what :func:`kept_person` reads."""
    fit, estimate = result.fit, result.estimate
    sun = MovableSun.of(estimate)
    reflection = FaceReflection.of(estimate, result.view.observation)
    tensors = {name: torch.from_numpy(getattr(fit, name)) for name in _OF_FIT}
    tensors |= {
        "camera": torch.tensor(
            [fit.camera.focal_px, fit.camera.width, fit.camera.height, *fit.camera.center_px]
        ).double(),
        "found": light_in_photo(estimate).radiance,
        "rest": sun.rest.radiance,
        "direction": sun.direction.double(),
        "irradiance": sun.irradiance,
    }
    if fit.covariance is not None:
        tensors["covariance"] = torch.from_numpy(fit.covariance)
    if reflection.head_error is not None:
        tensors["head_error"] = reflection.head_error
    facts = command | {
        "is_lamp": bool(estimate.lamps),
        "was_found": sun.was_found,
        "strength": float(luminance(sun.irradiance)) / sun.level if sun.level > 0 else None,
        "level": sun.level,
        "spread_rad": sun.spread_rad,
        "gloss": reflection.gloss,
        "landmark_error": fit.landmark_error,
        "converged": fit.converged,
        "warning": warning_of(estimate),
    }
    write_tensors(folder / KEPT, tensors, {"facts": json.dumps(facts)})


def kept_person(folder: Path) -> KeptPerson:
    """What :func:`keep_person` wrote."""
    tensors, metadata = read_tensors(folder / KEPT)
    facts = json.loads(metadata["facts"])
    focal_px, width, height, *center_px = tensors["camera"].tolist()
    camera = Camera(
        focal_px=focal_px,
        width=int(width),
        height=int(height),
        center_px=(center_px[0], center_px[1]),
    )
    covariance: Tensor | None = tensors.get("covariance")
    fit = FaceFit(
        camera=camera,
        landmark_error=facts.pop("landmark_error"),
        converged=facts.pop("converged"),
        covariance=None if covariance is None else covariance.numpy(),
        **{name: tensors[name].numpy() for name in _OF_FIT},
    )
    sun = MovableSun(
        direction=tensors["direction"],
        irradiance=tensors["irradiance"],
        rest=EnvironmentMap(radiance=tensors["rest"]),
        level=facts.pop("level"),
        spread_rad=facts.pop("spread_rad"),
        was_found=facts["was_found"],
    )
    return KeptPerson(
        fit=fit,
        reflection=FaceReflection(gloss=facts.pop("gloss"), head_error=tensors.get("head_error")),
        found=EnvironmentMap(radiance=tensors["found"]),
        sun=sun,
        facts=facts,
    )
