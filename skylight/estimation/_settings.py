"""What an estimate depends on besides its pictures: one set of options for all who ask for one.

Python's :func:`~skylight.estimation._photos.estimate`, the commands, folders, films, portraits and
the studio take theirs from here. A new option is a field of :class:`EstimateSettings`, its line in
:class:`SettingKeywords`, and a parameter of the command.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import TypedDict

import torch

from skylight._names import (
    DEFAULT_DETAIL,
    DEFAULT_LIGHT,
    DEFAULT_SOLVER,
    DetailName,
    HeadName,
    LandmarkerName,
    Place,
    SolverName,
    WhichFaces,
    check_detail_name,
    check_solver_name,
)
from skylight.faces._landmarkers import choose_landmarker
from skylight.faces._landmarks import FaceLandmarker
from skylight.imaging._colour import Decode
from skylight.inverse._estimate import (
    check_goes_together,
    light_problems,
    light_there,
)
from skylight.inverse._own_light import own_light, told
from skylight.inverse._problem import LightProblem
from skylight.inverse._sky import SOLVERS
from skylight.inverse._sun_prior import SunPrior
from skylight.models._base import Light, LightPrior, name_of
from skylight.models._bundle import Model, load_model
from skylight.models._ground import KnownGround, check_has_ground
from skylight.work._device import choose_device


class SettingKeywords(TypedDict, total=False):
    """The fields of :class:`EstimateSettings` as keyword arguments."""

    light: Light
    prior: LightPrior | None
    model: Model | None
    solver: SolverName
    face: WhichFaces
    head: HeadName
    decode: Decode | None
    landmarks: LandmarkerName | FaceLandmarker
    ignore_exif_sun: bool
    ground: KnownGround | None
    place: Place
    detail: DetailName
    device: str


@dataclass(frozen=True, kw_only=True)
class EstimateSettings:
    """Options of an estimate.

    Parameters
    ----------
    light
        The light model: "sphere" (any place, all round), "autoencoder" (learnt skies), "sunsky"
        (Preetham's sky and a sun), "lamps" (up to three in ambient light), "auto" (the likelier of
        "autoencoder" and "lamps"), "sh9" or "sh25" (spherical harmonics up to degree 2 or 4); or a
        :class:`~skylight.models._base.LightModel` of your own. The default gives way to
        "autoencoder" where something is asked that only skies have
        (:func:`~skylight.inverse._estimate.light_there`).
    prior
        The density of such a model's free parameters, as for
        :func:`~skylight.inverse._estimate.estimate_light`; by default all are alike.
    model
        A trained model of your own, or its folder, in place of the one that comes with skylight:
        the places of "sphere", the network of "autoencoder", or the prior of "sunsky".
        ``skylight train`` makes them.
    solver
        How the sky of "autoencoder" is searched for: "scan", from many starts where a scan finds
        the sun, or "thesis", from the mean sky by L-BFGS on four levels (B.1).
    face
        Which face of each picture, counted from 1, the largest; or "all", under one light.
    head
        "fitted": the morphable model's head. "deformed": that head bent by bounded biharmonic
        weights until its inner landmarks are where they were detected, as in the thesis; better
        only with landmarks that are exact to a millimetre.
    decode
        How values encode light: "srgb", "linear" or the exponent of a power law; None for what
        the file says. Not for a ``Photo``, which is decoded already.
    landmarks
        What finds the face: "mediapipe", "dlib" (for research only, an extra), or a
        :class:`~skylight.faces._landmarks.FaceLandmarker` of your own.
    ignore_exif_sun
        Leave the time, place and heading of EXIF data unused. Their focal length counts all the
        same, and for "auto" and "sphere" the exposure of the first picture.
    ground
        The albedo of the ground where it is known, for skies over a ground ("auto",
        "autoencoder", "sunsky", your own) and "sphere"; by default what is usual.
    place
        "outdoors", "indoors" or "flash" (on the camera) where that is known: rules out kinds of
        place for "sphere", which is taken in place of "auto".
    detail
        What the written map shows beside its light (:mod:`~skylight.estimation._detail`): "none",
        "photo" (the photograph's own pixels inside its view) or "mirrored" (its texture round the
        sphere too, for reflections). The light stays the same.
    device
        Where light is traced and optimised: "cpu", "cuda", or "auto" for CUDA where it is.

    Raises
    ------
    InputError
        An unknown name, or options that do not go together.
    """

    light: Light = DEFAULT_LIGHT
    prior: LightPrior | None = None
    model: Model | None = None
    solver: SolverName = DEFAULT_SOLVER
    face: WhichFaces = 1
    head: HeadName = "fitted"
    decode: Decode | None = None
    landmarks: LandmarkerName | FaceLandmarker = "mediapipe"
    ignore_exif_sun: bool = False
    ground: KnownGround | None = None
    place: Place = "auto"
    detail: DetailName = DEFAULT_DETAIL
    device: str = "auto"

    def __post_init__(self) -> None:
        solver = "" if self.solver == DEFAULT_SOLVER else f"the solver {self.solver}"
        light = light_there(self.light, self.place, model=self.model, of_skies=solver)
        object.__setattr__(self, "light", light)
        check_goes_together(light, self.prior, self.model)
        check_solver_name(self.solver, name_of(light))
        check_has_ground(light, self.ground)
        check_detail_name(self.detail)
        where = choose_device(self.device)
        if not isinstance(light, str):
            own_light(light, self.prior, where)

    @property
    def landmarker(self) -> FaceLandmarker:
        """What finds faces; names of what is not installed are refused here."""
        if isinstance(self.landmarks, str):
            return choose_landmarker(self.landmarks)
        return self.landmarks

    @property
    def rays_on(self) -> torch.device | None:
        """Where light is traced: on the GPU that is used, else by embree (None)."""
        chosen = choose_device(self.device)
        return None if chosen.type == "cpu" else chosen

    @property
    def with_model(self) -> "EstimateSettings":
        """With a model that was read, for many estimates."""
        return self if self.model is None else replace(self, model=load_model(self.model))

    def problems(
        self,
        sun_priors: Sequence[SunPrior | None] = (None,),
        exposures: Sequence[float | None] = (None,),
    ) -> Sequence[LightProblem]:
        """An empty problem for each prior of a sun and exposure value."""
        return light_problems(
            self.light,
            len(sun_priors),
            prior=self.prior,
            model=self.model,
            options=replace(SOLVERS[self.solver], ground=self.ground),
            sun_priors=sun_priors,
            exposures=exposures,
            place=self.place,
            device=self.device,
        )

    def facts(self) -> dict[str, object]:
        """For notes: the same for the same model files, wherever they lie, and on any device."""
        facts: dict[str, object] = {each.name: getattr(self, each.name) for each in fields(self)}
        del facts["device"], facts["prior"]
        if not isinstance(self.light, str):
            facts["light"] = {"name": self.light.name, **told(self.light)}
        if self.prior is not None:
            facts["prior"] = told(self.prior)
        if self.model is not None:
            facts["model"] = load_model(self.model).fingerprint
        if self.solver == DEFAULT_SOLVER:  # notes of runs before there was another
            del facts["solver"]
        if self.place == "auto":
            del facts["place"]
        if self.ground is None:
            del facts["ground"]
        else:
            facts["ground"] = asdict(self.ground)
        return facts
