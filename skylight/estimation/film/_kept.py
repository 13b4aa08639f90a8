"""What of a film's light portraits are relit by, kept beside its results."""

import json
import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray
from torch import Tensor

from skylight.errors import InputError
from skylight.estimation._kept import kept_file, kept_lamps, lamp_tensors, warning_of, way_to
from skylight.estimation._manifest import file_hash
from skylight.estimation.film._estimate import FilmEstimate
from skylight.faces._fit import FaceFit, FitState
from skylight.faces._model import HeadModel
from skylight.imaging._colour import Decode
from skylight.imaging._edits import Edit
from skylight.inverse._result import Lamp
from skylight.io._tensors import read_tensors, write_tensors
from skylight.sphere._envmap import EnvironmentMap
from skylight.transport._cameras import Camera

KEPT_FILM = "film.safetensors"
_OF_FITS = ("rotation", "translation", "expression")
_OF_FRAMES = ("frames", "times_s", "points", "world_from_camera")


@dataclass(frozen=True, kw_only=True)
class KeptFilm:
    """The light of a film ``file`` and its person at K keyframes, in the order of time.

    ``environment`` and ``lamps`` are the mean light, in the world's frame and the first keyframe's
    units, as ``white_balance`` shows them; that, ``edit`` and ``specular_scale`` are medians over
    keyframes. ``poses`` are in pictures of ``size`` (width, height), of which the keyframes are
    numbers ``frames`` (K,) at ``times_s``, with the landmarks ``points`` and the camera turned by
    ``world_from_camera``. What lies before ``shot`` (begin and end in
    seconds) may show another one, and what begins at its end does; that of the last is infinite.
    """

    environment: EnvironmentMap
    white_balance: Float[Tensor, "3"]
    lamps: tuple[Lamp, ...]
    edit: Edit
    specular_scale: float
    poses: tuple[FitState, ...]
    size: tuple[int, int]
    frames: Int[ndarray, " k"]
    times_s: Float[ndarray, " k"]
    points: Float[ndarray, "k 478 2"]
    world_from_camera: Float[ndarray, "k 3 3"]
    shot: tuple[float, float]
    face: int
    verdict: str
    advice: tuple[str, ...]
    warning: str
    file: Path
    decode: Decode | None

    @staticmethod
    def of(result: FilmEstimate, file: Path, decode: Decode | None, face: int) -> "KeptFilm":
        """Of a film's estimate."""
        light, start = result.light, result.light.start
        edits = [frame.edit for frame in light.frames]
        shot = result.followed.shot
        points = []
        for one in result.keyframes:
            assert one.face.readings is not None  # MediaPipe's
            points.append(one.face.readings.mean(0))
        return KeptFilm(
            environment=light.mean.environment,
            white_balance=torch.stack([frame.white_balance for frame in light.frames]).quantile(
                0.5, dim=0
            ),
            lamps=light.mean.lamps,
            edit=Edit(
                saturation=float(np.median([edit.saturation for edit in edits])),
                contrast=float(np.median([edit.contrast for edit in edits])),
                pivot=float(np.median([edit.pivot for edit in edits])),
            ),
            specular_scale=light.specular_scale,
            poses=tuple(
                FitState(
                    rotation=fit.rotation,
                    translation=fit.translation,
                    log_focal=float(np.log(fit.camera.focal_px)),
                    identity=fit.identity,
                    expression=fit.expression,
                )
                for fit in result.fits
            ),
            size=result.followed.size,
            frames=np.array([one.number for one in result.keyframes]),
            times_s=np.array([one.time_s for one in result.keyframes]),
            points=np.array(points),
            world_from_camera=np.array(result.world_from_camera),
            shot=(shot.begin_s, shot.until_s),
            face=face,
            verdict=start.verdict.summary,
            advice=result.advice,
            warning=warning_of(start),
            file=file,
            decode=decode,
        )

    def fit(self, pose: FitState, size: tuple[int, int] | None = None) -> FaceFit:
        """The head in that pose, in pictures of another ``size`` where it is given."""
        width, height = self.size
        camera = Camera(
            focal_px=float(np.exp(pose.log_focal)),
            width=width,
            height=height,
            center_px=(width / 2, height / 2),
        )
        shape = HeadModel.load().vertices(pose.identity, pose.expression)
        return FaceFit(
            camera=camera if size is None else camera.resized(*size),
            rotation=pose.rotation,
            translation=pose.translation,
            identity=pose.identity,
            expression=pose.expression,
            vertices=shape @ pose.rotation.T + pose.translation,
            landmark_error=0.0,
            converged=True,
        )


def write_film(folder: Path, film: KeptFilm) -> None:
    """Write :data:`KEPT_FILM`, about 2 MB."""
    tensors = {
        name: torch.from_numpy(np.array([getattr(pose, name) for pose in film.poses]))
        for name in _OF_FITS
    }
    tensors |= {name: torch.from_numpy(getattr(film, name)) for name in _OF_FRAMES}
    tensors |= {
        "identity": torch.from_numpy(film.poses[0].identity),
        "environment": film.environment.radiance,
        "white_balance": film.white_balance,
    }
    tensors |= lamp_tensors(film.lamps)
    facts = {
        "film": way_to(folder, film.file),
        "sha256": file_hash(film.file),
        "decode": film.decode,
        "log_focal": film.poses[0].log_focal,
        "spreads_rad": [lamp.spread_rad for lamp in film.lamps],
        "edit": asdict(film.edit),
        "specular_scale": film.specular_scale,
        "size": film.size,
        "shot": [None if math.isinf(time_s) else time_s for time_s in film.shot],
        "face": film.face,
        "verdict": film.verdict,
        "advice": film.advice,
        "warning": film.warning,
    }
    write_tensors(
        folder / KEPT_FILM,
        {name: tensor.contiguous() for name, tensor in tensors.items()},
        {"facts": json.dumps(facts)},
    )


def read_film(folder: Path) -> KeptFilm:
    """What a film's estimate kept in its folder.

    Raises
    ------
    InputError
        There is none, or it is damaged; the film is gone, or is another one by now.
    """
    path = folder / KEPT_FILM
    if not path.is_file():
        raise InputError(
            f"{folder}: no {KEPT_FILM} in it, by which films are relit: estimate the film again "
            "(skylight estimate --video; a folder of frames has none)"
        )
    try:
        tensors, metadata = read_tensors(path)
        facts = json.loads(metadata["facts"])
        counts = {name: len(tensors[name]) for name in (*_OF_FITS, *_OF_FRAMES)}
        if len(set(counts.values())) > 1:
            raise ValueError(f"not of as many keyframes: {counts}")
        poses = tuple(
            FitState(
                log_focal=facts["log_focal"],
                identity=tensors["identity"].numpy(),
                **{name: tensors[name][k].numpy() for name in _OF_FITS},
            )
            for k in range(len(tensors["frames"]))
        )
        width, height = facts["size"]
        begin_s, end_s = facts["shot"]
        film = KeptFilm(
            environment=EnvironmentMap(radiance=tensors["environment"]),
            white_balance=tensors["white_balance"],
            lamps=kept_lamps(tensors, facts["spreads_rad"]),
            edit=Edit(**facts["edit"]),
            poses=poses,
            size=(width, height),
            frames=tensors["frames"].numpy(),
            times_s=tensors["times_s"].numpy(),
            points=tensors["points"].numpy(),
            world_from_camera=tensors["world_from_camera"].numpy(),
            shot=(begin_s, math.inf if end_s is None else end_s),
            advice=tuple(facts["advice"]),
            file=Path(facts["film"]),
            **{
                name: facts[name]
                for name in ("specular_scale", "face", "verdict", "warning", "decode")
            },
        )
        where, sha256 = facts["film"], facts["sha256"]
    except (OSError, ValueError, KeyError, IndexError, TypeError) as error:
        raise InputError(
            f"{path}: damaged ({error}); estimate the film again (skylight estimate --video)"
        ) from error
    return replace(film, file=kept_file(folder, where, sha256, "film"))
