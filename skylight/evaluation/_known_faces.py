"""Faces whose illumination, geometry and skin are known, and light estimated from them.

They are rendered on the spot or read from a folder of ``skylight faces render``. What evaluations
of faces have in common is here: with which trained model, effort and device light is estimated,
and what the estimates' scores and costs are.
"""

import hashlib
import json
import math
import resource
import sys
import time
from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from skylight._names import DEFAULT_LIGHT, DEFAULT_SKY, LightName, is_trained
from skylight.errors import InputError
from skylight.evaluation._run import Check, Evaluation, Item, trained_model
from skylight.faces._fit import FaceFit, fit_face, fit_visible
from skylight.faces._landmarkers import choose_landmarker
from skylight.faces._landmarks import choose_face
from skylight.faces._model import HeadModel
from skylight.faces._observe import FaceView, observe_face
from skylight.faces._synthetic import SyntheticFace, render_face
from skylight.imaging._colour import tone_map
from skylight.imaging._photo import Photo
from skylight.inverse._auto import RIVALS, choose
from skylight.inverse._estimate import estimate_light
from skylight.inverse._posterior import SunPosterior
from skylight.inverse._result import Estimate
from skylight.inverse._scores import score
from skylight.inverse._sky import SolverOptions
from skylight.models._bundle import Model, is_of_places
from skylight.models._ground import GROUND_ALBEDOS
from skylight.people._files import RenderedFace, read_rendered_face, rendered_faces
from skylight.people._light import LOWEST_TRANSMITTANCE
from skylight.skies._simulated import simulated_skies
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.transport._observation import Observation
from skylight.work._device import choose_device

FIRST_SEED = 20_000_000
_SEEDS_APART = 1000  # so that each face finds a day of its own


@dataclass(frozen=True, kw_only=True)
class KnownFace(SyntheticFace):
    """A picture and what made it.

    ``tone`` is the cluster of skin tones that the person was drawn from (0 the lightest), or None
    where none was drawn.
    """

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
    own = {each.name: getattr(face, each.name) for each in fields(SyntheticFace)}
    return KnownFace(**own, sun_visible=sun_visible, tone=tone)


_DEFAULT = SolverOptions()


@dataclass(frozen=True, kw_only=True)
class EstimateOptions:
    """``model`` is a trained model or its folder, None for the one that comes with skylight.

    ``solver`` leaves parts of the objective out where its weights are 0, for ablations.
    """

    model: Model | None = None
    device: str = "auto"
    solver: SolverOptions = _DEFAULT

    def config(self) -> dict[str, object]:
        """What results depend on: the model's tensors, and a solver of other options."""
        config: dict[str, object] = {}
        if self.model is not None:
            config["model"] = trained_model(self.model).fingerprint
        if self.solver != _DEFAULT:
            config["solver"] = asdict(self.solver)
        return config

    @property
    def light(self) -> LightName:
        """The default light; with a trained model of skies learnt ones."""
        of_skies = self.model is not None and not is_of_places(self.model)
        return DEFAULT_SKY if of_skies else DEFAULT_LIGHT

    def with_evidence(self) -> "EstimateOptions":
        """The same, so that skies can compete with lamps."""
        return replace(self, solver=replace(self.solver, evidence=True))

    def estimate(
        self, observations: Observation | Sequence[Observation], light: LightName
    ) -> Estimate:
        """:func:`estimate_light`, by the trained model where it is for that light."""
        model = None if self.model is None else trained_model(self.model)
        if model is not None and not is_trained(light, of_places=is_of_places(model)):
            model = None
        return estimate_light(
            observations, light, model=model, options=self.solver, device=self.device
        )


NOT_FOUND = "no face found by the landmark detector"
CHOSEN = 0.9  # of rooms and lamps, by "auto"
METHODS: tuple[LightName, ...] = ("sh9", "sh25", "sunsky", "autoencoder")


@dataclass(frozen=True, kw_only=True)
class LitFace:
    """Estimates by method, all from one ``view`` of the head ``fit``, and their metrics.

    ``seconds`` are what each stage took.
    """

    fit: FaceFit
    view: FaceView
    estimates: dict[str, Estimate]
    metrics: dict[str, dict[str, float]]
    seconds: dict[str, float]

    @property
    def facts(self) -> dict[str, object]:
        """What "auto" chose, where it was asked, and what the estimates took."""
        costs = {"seconds": self.seconds, "peak_mib": peak_mib()}
        return choice_facts(self.estimates) | costs


@dataclass(frozen=True, kw_only=True)
class FaceEvaluation(Evaluation):
    """An evaluation that estimates light from faces, as ``options`` say."""

    options: EstimateOptions = EstimateOptions()

    def config(self) -> dict[str, object]:
        own = super().config()
        del own["options"]
        return own | self.options.config()

    def with_model(self, model: Model | None, device: str) -> "FaceEvaluation":
        choose_device(device)
        return replace(self, options=replace(self.options, model=model, device=device))

    def lit(self, face: KnownFace, methods: tuple[LightName, ...]) -> LitFace:
        """Every method's light of a rendered face, from the head that its picture gives."""
        seconds: dict[str, float] = {}
        fit = fitted_head(face, seconds)
        return light_of(face, fit, methods, seconds, options=self.options)


@dataclass(frozen=True, kw_only=True)
class KnownFaceEvaluation(FaceEvaluation):
    """Over the faces of a :class:`FaceSource`."""

    selects = ("data", "count", "size", "seed")  # the source's own configuration stands for them

    @property
    @abstractmethod
    def source(self) -> FaceSource: ...

    def config(self) -> dict[str, object]:
        return super().config() | self.source.config()

    def items(self) -> list[str]:
        return self.source.names()


def fitted_head(face: KnownFace, seconds: dict[str, float]) -> FaceFit:
    """The head as a photograph's would be fitted.

    ``seconds`` gets what each stage took: "landmarks" and "head".
    """
    height, width = face.encoded.shape[:2]
    with stage(seconds, "landmarks"):
        faces = choose_landmarker().detect(face.encoded)
    if not faces:
        raise InputError(NOT_FOUND)
    with stage(seconds, "head"):
        return fit_face(HeadModel.load(), faces[0], width, height)


def light_of(
    face: KnownFace,
    fit: FaceFit,
    methods: tuple[LightName, ...],
    seconds: dict[str, float],
    *,
    face_height_px: int | None = None,
    options: EstimateOptions = EstimateOptions(),
) -> LitFace:
    """Every method's light, with the head where ``fit`` says; transport is traced once.

    ``seconds`` gets what each stage took: "transport", and each method under its name.
    """
    observe = observe_face
    if face_height_px is not None:
        observe = partial(observe_face, face_height_px=face_height_px)
    with stage(seconds, "transport"):
        view = observe(face.picture, face.clipped, HeadModel.load(), fit)
    cpu_seconds: dict[str, float] = {}
    estimates = light_by_method(view.observation, methods, seconds, options, cpu_seconds)
    metrics = {
        method: face_score(estimate.environment, face)
        | {
            "seconds": seconds[method],
            "cpu_seconds": cpu_seconds[method],
            "transport_seconds": seconds["transport"],
        }
        for method, estimate in estimates.items()
    }
    return LitFace(fit=fit, view=view, estimates=estimates, metrics=metrics, seconds=seconds)


def light_by_method(
    observation: Observation,
    methods: Sequence[LightName],
    seconds: dict[str, float],
    options: EstimateOptions,
    cpu_seconds: dict[str, float] | None = None,
) -> dict[str, Estimate]:
    """The light of a face by every method; ``seconds`` get what each took, under its name.

    "auto" chooses from those of :data:`~skylight.inverse._auto.RIVALS`, which come before it.
    """
    cpu_seconds = {} if cpu_seconds is None else cpu_seconds
    if "auto" in methods:
        options = options.with_evidence()
    estimates: dict[str, Estimate] = {}
    for method in methods:
        if method == "auto":  # which takes what its rivals take
            if not {*RIVALS} <= {*estimates}:
                raise InputError(f"auto chooses from {' and '.join(RIVALS)}: name them first")
            estimates[method] = choose([estimates[rival] for rival in RIVALS])
            for times in (seconds, cpu_seconds):
                times[method] = sum(times[rival] for rival in RIVALS)
            continue
        cpu_start = time.process_time()
        with stage(seconds, method):
            estimates[method] = options.estimate(observation, method)
        cpu_seconds[method] = time.process_time() - cpu_start
    return estimates


def choice_facts(estimates: Mapping[str, Any]) -> dict[str, object]:
    """What "auto" chose, and the evidence of every model; nothing where it was not asked."""
    if "auto" not in estimates:
        return {}
    return {
        "chosen": estimates["auto"].light,
        "evidence": {name: one.log_evidence for name, one in estimates.items()},
    }


def lamps_chosen(items: list[Item]) -> dict[str, Check]:
    """For which part of the items "auto" chose lamps; none where it was not asked."""
    chosen = [item.facts["chosen"] == "lamps" for item in items if "chosen" in item.facts]
    if not chosen:
        return {}
    share = float(np.mean(chosen))
    return {"faces for which lamps are chosen": Check.at_least(share, CHOSEN)}


def observe_largest(
    photo: Photo, name: str, seconds: dict[str, float] | None = None
) -> tuple[FaceFit, FaceView]:
    """Head and pixels of a photograph's largest face, as an estimate sees them."""
    seconds = {} if seconds is None else seconds
    model = HeadModel.load()
    with stage(seconds, "landmarks"):
        face = choose_face(choose_landmarker().detect(photo.encoded), 1, name)
    with stage(seconds, "head"):
        fit = fit_visible(model, photo, face, name)
    with stage(seconds, "transport"):
        return fit, observe_face(photo.pixels, photo.clipped, model, fit)


def seen_and_rendered(view: FaceView, rendered: Float[Tensor, "m 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """The picture, and beside it the face as the estimate renders it."""
    shown = view.image.clone()
    rows, columns = view.places.unbind(1)
    shown[rows, columns] = rendered[view.blocks]
    white = float(luminance(view.image[rows, columns]).quantile(0.98))
    return np.hstack([tone_map(picture, white=white) for picture in (view.image, shown)])


def coverage(posterior: SunPosterior, sun: Float[Tensor, "3"]) -> dict[str, float]:
    """``in_region``: 1 where the 90 % region holds the true sun's cell; ``region_sr``: its size."""
    directions = posterior.grid.directions
    cell = int((directions @ sun.to(directions)).argmax())
    return {
        "in_region": float(bool(posterior.region[cell])),
        "region_sr": posterior.region_sr,
    }


def face_score(found: EnvironmentMap, face: KnownFace) -> dict[str, float]:
    return score(found, face.environment, sun_visible=face.sun_visible)


@contextmanager
def stage(seconds: dict[str, float], name: str) -> Iterator[None]:
    """Adds the seconds that the block took to those noted under ``name``."""
    start = time.perf_counter()
    yield
    seconds[name] = seconds.get(name, 0.0) + time.perf_counter() - start


def peak_mib() -> float:
    """Most memory that this process has held so far, MiB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)


def pose_error_deg(fit: FaceFit, truth: FaceFit) -> float:
    """Angle of the rotation R_fit^T R_true."""
    cosine = (np.trace(fit.rotation.T @ truth.rotation) - 1) / 2
    return math.degrees(math.acos(float(np.clip(cosine, -1, 1))))
