"""Faces of known illumination, geometry and skin: simulated, or read from a folder."""

import hashlib
import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from skylight.errors import InputError
from skylight.evaluation.rendered_faces.files import (
    RenderedFace,
    read_rendered_face,
    rendered_faces,
)
from skylight.evaluation.rendered_faces.light.scene_light import LOWEST_TRANSMITTANCE
from skylight.faces.fit import FaceFit
from skylight.faces.synthetic import SyntheticFace, render_face
from skylight.models.ground import GROUND_ALBEDOS
from skylight.skies.simulated import simulated_skies
from skylight.sphere.envmap import EnvironmentMap

FIRST_SEED = 20_000_000
_SEEDS_APART = 1000  # so that each face finds a day of its own


@dataclass(frozen=True, kw_only=True)
class KnownFace:
    """A picture and what made it; fields as in :class:`skylight.faces.synthetic.SyntheticFace`.

    ``tone`` is the cluster of skin tones that the person was drawn from (0 the lightest), or None
    where none was drawn.
    """

    encoded: UInt8[np.ndarray, "h w 3"]
    picture: Float[Tensor, "h w 3"]
    clipped: Bool[Tensor, "h w"]
    environment: EnvironmentMap
    albedo: Float[Tensor, "3"]
    truth: FaceFit
    sun_visible: bool
    tone: int | None = None


@dataclass(frozen=True, kw_only=True)
class FaceSource:
    """Faces by name: those of the folder ``data``, or ``count`` people rendered on the spot.

    Of a folder the first ``count`` are taken (all where it is None). Those rendered on the spot
    stand under test skies with a visible sun and have a picture of ``size`` pixels a side.
    """

    data: Path | None
    count: int | None
    size: int = 256
    seed: int = FIRST_SEED

    def config(self) -> dict[str, object]:
        """What a face depends on besides its name: of a folder, its faces' facts and pictures."""
        if self.data is None:
            return {"size": self.size, "seed": self.seed}
        digest = hashlib.sha256()
        for name in self.names():
            face = self.data / name
            try:
                for part in (face / "face.json", face / "picture.png"):
                    content = hashlib.sha256(part.read_bytes()).hexdigest()
                    digest.update(f"{name} {part.name} {content}\n".encode())
            except OSError as error:
                raise InputError(f"{face}: no complete rendered face ({error})") from error
        return {"faces": digest.hexdigest()}

    def names(self) -> list[str]:
        if self.data is None:
            return [f"face{i:04d}" for i in range(self.count or 0)]
        return [folder.name for folder in rendered_faces(self.data)][: self.count]

    def scene(self, name: str) -> int:
        """Which scene a face of the folder belongs to, from its facts alone."""
        if self.data is None:
            raise InputError("only faces of a folder have scenes: give it as data")
        facts = self.data / name / "face.json"
        try:
            return int(json.loads(facts.read_text(encoding="utf-8"))["scene"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(f"{facts}: no facts of a rendered face ({error})") from error

    def read(self, name: str) -> KnownFace:
        if self.data is None:
            number = int(name.removeprefix("face"))
            return rendered_here(self.seed + _SEEDS_APART * number, self.size)
        return read_face(self.data / name)


@lru_cache(maxsize=2)
def rendered_here(seed: int, size: int) -> KnownFace:
    return _known(synthetic_face(seed, size), sun_visible=True)


def synthetic_face(seed: int, size: int) -> SyntheticFace:
    """A person under the first sunny sky found from ``seed`` on, over one of nine grounds."""
    ((_, sky),) = simulated_skies(1, first_seed=seed, lowest_transmittance=LOWEST_TRANSMITTANCE)
    albedo = GROUND_ALBEDOS[np.random.default_rng(seed).integers(len(GROUND_ALBEDOS))]
    return render_face(sky, torch.tensor(albedo), seed=seed, size=size)


def read_face(folder: Path) -> KnownFace:
    """A face that ``skylight faces render`` wrote."""
    return known_face(read_rendered_face(folder))


def known_face(face: RenderedFace) -> KnownFace:
    """A rendered face as one to estimate light from; a map that it was given shows no sun."""
    through = face.sun_transmittance
    visible = through is not None and through >= LOWEST_TRANSMITTANCE
    return _known(face, sun_visible=visible, tone=face.cluster)


def _known(face: SyntheticFace, *, sun_visible: bool, tone: int | None = None) -> KnownFace:
    return KnownFace(
        encoded=face.encoded,
        picture=face.picture,
        clipped=face.clipped,
        environment=face.environment,
        albedo=face.albedo,
        truth=face.truth,
        sun_visible=sun_visible,
        tone=tone,
    )
