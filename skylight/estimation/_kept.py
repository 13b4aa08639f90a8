"""What of an estimate a portrait is relit by, kept beside its results: nothing is estimated again.

Fit, reflection and light are stored exactly, so the portrait is the one that the estimate itself
would have given. Of the photograph are stored its place, seen from the results, and its hash.
"""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal, Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.estimation._manifest import file_hash
from skylight.estimation._summary import PhotoEstimate
from skylight.faces._fit import FaceFit
from skylight.imaging._colour import Decode
from skylight.imaging._edits import UNEDITED, Edit
from skylight.imaging._photo import Photo, read_photo
from skylight.inverse._result import Estimate, Lamp
from skylight.io._atomic import PARTIAL
from skylight.io._tensors import read_tensors, write_tensors
from skylight.sphere._envmap import EnvironmentMap
from skylight.transport._cameras import Camera
from skylight.transport._observation import Observation

KEPT = "person.safetensors"
_OF_FIT = ("rotation", "translation", "identity", "expression", "vertices")


@dataclass(frozen=True, kw_only=True)
class FaceReflection:
    """What an estimate tells of a face beside its light.

    ``edit`` is what was done to its photograph. ``specular_scale`` is that of
    :class:`~skylight.inverse._result.FaceLight`; by ``head_error``, pose and shape are off, as
    :func:`~skylight.faces._normal_errors.normal_changes` takes it.
    """

    specular_scale: float
    head_error: Float[Tensor, " d"] | None
    edit: Edit = UNEDITED

    @staticmethod
    def of(estimate: Estimate, seen: Observation) -> "FaceReflection":
        """The (first) face's, which was ``seen``."""
        face, modes = estimate.faces[0], seen.normal_modes
        error = None
        if face.turns is not None and modes is not None and modes.axes is not None:
            error = modes.axes @ face.turns.to(modes.axes)
        return FaceReflection(specular_scale=face.specular_scale, head_error=error, edit=face.edit)


def warning_of(estimate: Estimate) -> str:
    """Why not to trust a portrait that was lit by it; empty where nothing is against it."""
    verdict = estimate.verdict
    if verdict.doubt:
        return f"the light that was found is {verdict.summary}"
    if estimate.posterior.is_seen and verdict.direction.word == "unknown":
        return f"the direction of the light that was found is {verdict.direction}"
    return ""


@dataclass(frozen=True, kw_only=True)
class KeptFace:
    """The (first) face of an estimate in its photograph, which has a ``name``.

    That was read from ``file`` with ``decode``, or given in memory.

    ``environment``, ``white_balance``, ``lamps`` and ``advice`` are the estimate's, ``verdict`` is
    that in words, and ``warning`` is :func:`warning_of` it.
    """

    photo: Photo
    name: str
    fit: FaceFit
    reflection: FaceReflection
    environment: EnvironmentMap
    white_balance: Float[Tensor, "3"]
    lamps: tuple[Lamp, ...]
    verdict: str
    advice: tuple[str, ...]
    warning: str
    file: Path | None = None
    decode: Decode | None = None

    @staticmethod
    def of(result: "PhotoEstimate | KeptFace") -> "KeptFace":
        """That of an estimate; one that was kept is itself."""
        if isinstance(result, KeptFace):
            return result
        estimate, number = result.estimate, result.seen[0].photo
        return KeptFace(
            photo=result.photos[number],
            name=result.names[number],
            fit=result.fit,
            reflection=FaceReflection.of(estimate, result.view.observation),
            environment=estimate.environment,
            white_balance=estimate.white_balance,
            lamps=estimate.lamps,
            verdict=estimate.verdict.summary,
            advice=estimate.advice,
            warning=warning_of(estimate),
            file=dict(enumerate(result.files)).get(number),
            decode=result.decode,
        )


@runtime_checkable
class FoundLight(Protocol):
    """Whose light a new one is made of: an estimate, or what is kept of one or of a film's."""

    @property
    def environment(self) -> EnvironmentMap: ...
    @property
    def white_balance(self) -> Float[Tensor, "3"]: ...
    @property
    def lamps(self) -> tuple[Lamp, ...]: ...


def write_face(folder: Path, face: KeptFace) -> None:
    """Write :data:`KEPT`, about 2 MB; a photograph that was no file has to be given again."""
    file, fit, camera = face.file, face.fit, face.fit.camera
    tensors = {name: torch.from_numpy(getattr(fit, name)) for name in _OF_FIT}
    tensors |= {
        "camera": torch.tensor(
            [camera.focal_px, camera.width, camera.height, *camera.center_px], dtype=torch.float64
        ),
        "environment": face.environment.radiance,
        "white_balance": face.white_balance,
    }
    tensors |= lamp_tensors(face.lamps)
    if fit.covariance is not None:
        tensors["covariance"] = torch.from_numpy(fit.covariance)
    if face.reflection.head_error is not None:
        tensors["head_error"] = face.reflection.head_error
    facts = {
        "photo": None if file is None else way_to(folder, file),
        "sha256": None if file is None else file_hash(file),
        "decode": face.decode,
        "name": face.name,
        "spreads_rad": [lamp.spread_rad for lamp in face.lamps],
        "specular_scale": face.reflection.specular_scale,
        "edit": asdict(face.reflection.edit),
        "landmark_error": fit.landmark_error,
        "converged": fit.converged,
        "verdict": face.verdict,
        "advice": face.advice,
        "warning": face.warning,
    }
    write_tensors(folder / KEPT, tensors, {"facts": json.dumps(facts)})


def lamp_tensors(lamps: Sequence[Lamp]) -> dict[str, Tensor]:
    """Directions and irradiances, nothing of no lamp; spreads are kept as numbers."""
    if not lamps:
        return {}
    return {
        "directions": torch.stack([lamp.direction for lamp in lamps]),
        "irradiances": torch.stack([lamp.irradiance for lamp in lamps]),
    }


def kept_lamps(tensors: Mapping[str, Tensor], spreads_rad: Sequence[float]) -> tuple[Lamp, ...]:
    """Those of :func:`lamp_tensors`, of so many spreads."""
    return tuple(
        Lamp(
            direction=tensors["directions"][number],
            irradiance=tensors["irradiances"][number],
            spread_rad=spread_rad,
        )
        for number, spread_rad in enumerate(spreads_rad)
    )


def way_to(folder: Path, file: Path) -> str:
    """The way from the results to the photograph, which may be moved together."""
    # results are written into a folder within the one that they move to
    results = folder.parent if folder.name.startswith(PARTIAL) else folder
    try:
        return Path(os.path.relpath(file.resolve(), results.resolve())).as_posix()
    except ValueError:  # another drive of Windows
        return file.resolve().as_posix()


def read_face(folder: Path, photo: Photo | None = None) -> KeptFace:
    """What :func:`write_face` wrote; the photograph is read where it is not given.

    Raises
    ------
    InputError
        There is none, or it is damaged; the photograph is gone, or is another one by now.
    """
    path = folder / KEPT
    if not path.is_file():
        raise InputError(
            f"{folder}: no {KEPT} in it, by which portraits are relit: estimate the photograph "
            "again (skylight estimate), or name the photograph itself"
        )
    try:
        tensors, metadata = read_tensors(path)
        facts = json.loads(metadata["facts"])
        focal_px, width, height, *center_px = tensors["camera"].tolist()
        covariance = tensors.get("covariance")
        fit = FaceFit(
            camera=Camera(
                focal_px=focal_px,
                width=int(width),
                height=int(height),
                center_px=(center_px[0], center_px[1]),
            ),
            landmark_error=facts["landmark_error"],
            converged=facts["converged"],
            covariance=None if covariance is None else covariance.numpy(),
            **{name: tensors[name].numpy() for name in _OF_FIT},
        )
        lamps = kept_lamps(tensors, facts["spreads_rad"])
        reflection = FaceReflection(
            specular_scale=facts["specular_scale"],
            head_error=tensors.get("head_error"),
            edit=Edit(**facts["edit"]),
        )
        kept = {name: facts[name] for name in ("name", "verdict", "warning")}
        light = {
            "environment": EnvironmentMap(radiance=tensors["environment"]),
            "white_balance": tensors["white_balance"],
            "advice": tuple(facts["advice"]),
        }
        where, sha256, decode = facts["photo"], facts["sha256"], facts["decode"]
    except (OSError, ValueError, KeyError, IndexError, TypeError) as error:
        raise InputError(
            f"{path}: damaged ({error}); estimate the photograph again (skylight estimate)"
        ) from error
    file = None
    if photo is None:
        file = kept_file(folder, where, sha256)
        photo = read_photo(file, decode=decode)
    if photo.encoded.shape[:2] != (fit.camera.height, fit.camera.width):
        raise InputError(f"{kept['name']}: not of the size that was estimated; estimate it again")
    return KeptFace(
        photo=photo,
        fit=fit,
        reflection=reflection,
        lamps=lamps,
        file=file,
        decode=decode,
        **kept,
        **light,
    )


def kept_file(
    folder: Path,
    where: str | None,
    sha256: str | None,
    kind: Literal["photograph", "film"] = "photograph",
) -> Path:
    """The file that the results in ``folder`` were made of."""
    if where is None:
        raise InputError(f"{folder}: made of no file, so the {kind} is not known: name it")
    file = Path(os.path.normpath(folder.resolve() / where))
    if not file.is_file():
        raise InputError(
            f"{folder}: its {kind} is gone from {file}: put it back, or name the {kind}"
        )
    if file_hash(file) != sha256:
        other = "picture" if kind == "photograph" else kind
        raise InputError(
            f"{file}: another {other} than the one estimated into {folder}; estimate it again"
        )
    return file
