"""The doors of inverse lighting: observations -> the light that they were seen in."""

import copy
import math
from collections.abc import Sequence
from dataclasses import replace

from skylight._modes import without_autocast
from skylight._names import (
    DEFAULT_LIGHT,
    DEFAULT_SOLVER,
    SKY_LIGHTS,
    Place,
    SolverName,
    check_is_trained,
    check_light_name,
    light_at,
)
from skylight.errors import InputError
from skylight.faces._skin import SkinPrior
from skylight.inverse._auto import AutoProblem
from skylight.inverse._harmonic import HarmonicProblem
from skylight.inverse._lamps import LAMPS, LampsOptions, LampsProblem
from skylight.inverse._own_light import (
    called,
    check_light,
    follows_clock,
    is_linear,
    own_light,
    solved_together,
)
from skylight.inverse._problem import LightProblem, solve
from skylight.inverse._result import Estimate
from skylight.inverse._sky import SkyProblem, SolverOptions
from skylight.inverse._sphere import sphere_problem, towards_of
from skylight.inverse._sun_prior import SunPrior
from skylight.models._base import Light, LightPrior, name_of
from skylight.models._bundle import LightBundle, Model, is_of_places, load_bundle, load_model
from skylight.models._harmonic import HarmonicLight
from skylight.models._lamps import LampsLight
from skylight.models._prior import GaussianMixture
from skylight.models.autoencoder import AutoencoderLight
from skylight.models.sunsky import SunSky
from skylight.transport._observation import Observation
from skylight.work._device import choose_device
from skylight.work._progress import Progress

SUN_SPREAD_RAD = math.radians(1.4)  # half a pixel of the sky


@without_autocast
def estimate_light(
    observations: Observation | Sequence[Observation],
    light: Light = DEFAULT_LIGHT,
    *,
    prior: LightPrior | None = None,
    model: Model | None = None,
    photos: Sequence[int] | None = None,
    options: SolverOptions | None = None,
    sun_prior: SunPrior | None = None,
    exposure: float | None = None,
    place: Place = "auto",
    device: str = "auto",
    progress: Progress | None = None,
) -> Estimate:
    """The light of one observed face, or the one light of several: thesis, Eq. 5.8.

    Parameters
    ----------
    observations
        Pixels, weights and transport of each face; :func:`skylight.faces._observe.observe_face`
        makes them.
    light
        "sphere" (any place, with up to three lamps, on the whole sphere), which gives way to
        "autoencoder" where ``model`` is one of skies;
        "autoencoder" (learnt skies), "sunsky" (Preetham's sky and a sun), "lamps" (up to three in
        ambient light, on the whole sphere), "auto" (the likelier of "autoencoder" and "lamps"),
        "sh9" or "sh25" (spherical harmonics up to degree 2 or 4); or a
        :class:`~skylight.models._base.LightModel`, of a sky or the whole sphere, for which
        :class:`~skylight.models._base.ParametricLight` is a base.
    prior
        The density of that model's free parameters but the azimuth (``log_prob`` of it is asked,
        as ``torch.distributions`` have it). None says nothing about them: all are alike. Of the
        models that come with skylight, ``load_bundle().light()`` has ``load_bundle().prior()``,
        ``SunSky()`` has ``load_bundle().sunsky_prior``, ``SphereLight(k)`` ``SpherePrior(k)`` and
        ``LampsLight(k)`` ``LampsPrior(k)``.
    model
        A trained model of your own, or its folder, in place of the one that comes with skylight:
        the places of "sphere", the network of "autoencoder", or the prior of "sunsky".
    photos
        The photograph of each observation, counted from 0; by default all are of one. Faces of
        one photograph share its exposure.
    options
        Effort of the optimisation of skies, and weights of the objective; "sphere" and lamps have
        efforts of their own, harmonics none.
    sun_prior
        What time, place and heading tell of the sun, by
        :func:`skylight.inverse._sun_prior.sun_prior`. Of "sphere" the sun is one of the lamps, as
        likely as the place is under the open sky; indoors and with a flash it does not count.
    exposure
        The exposure value at ISO 100, which tells "auto" and "sphere" of rooms and daylight
        (:func:`~skylight.imaging._exif.exposure_value`); others do not use it.
    place
        "outdoors", "indoors" or "flash" where that is known: for "sphere", which is taken in place
        of "auto", it rules out kinds of place; with a flash one lamp is looked for at the camera
        too.
    device
        "cpu", "cuda", or "auto" for CUDA where it is. Transport is moved there once. The estimate
        is on the CPU.

    Raises
    ------
    InputError
        No observation, or one without a usable pixel; ``photos`` that do not count them; an
        unknown light model, or one that is not what a light model is; lamps, or a light of the
        whole sphere of your own, with a sun prior; no such device.
    """
    if isinstance(observations, Observation):
        observations = (observations,)
    photos = photos or [0] * len(observations)
    if len(photos) != len(observations) or {*photos} != {*range(len({*photos}))}:
        raise InputError(
            "photos has the number of each observation's photograph, counted from 0 without gaps; "
            f"for {len(observations)} observations got {list(photos)}"
        )
    (problem,) = light_problems(
        light,
        prior=prior,
        model=model,
        options=options,
        sun_priors=[sun_prior],
        exposures=[exposure],
        place=place,
        device=device,
    )
    for observation, photo in zip(observations, photos, strict=True):
        problem.add(observation, photo)
    return solve([problem], progress)[0]


@without_autocast
def estimate_each(
    observations: Sequence[Observation],
    light: Light = DEFAULT_LIGHT,
    *,
    prior: LightPrior | None = None,
    model: Model | None = None,
    options: SolverOptions | None = None,
    device: str = "auto",
    progress: Progress | None = None,
) -> list[Estimate]:
    """The light of each observation, each face in a light of its own.

    As :func:`estimate_light` of each, but for rounding, without priors and exposures. On a GPU
    skies (of "auto", "autoencoder" and "sunsky") and models of one's own are solved as one batch,
    which keeps it busy: give it as many as its memory holds
    (:class:`~skylight.inverse._sky.SkyProblem`). A CPU is busy with one, and takes an eighth longer
    for a batch: there, and for lamps and harmonics, they are solved in turn.

    Raises
    ------
    InputError
        As :func:`estimate_light`, for all where it is wrong with one.
    """
    if choose_device(device).type != "cpu" and solved_together(light, prior):
        many = light_problems(
            light, len(observations), prior=prior, model=model, options=options, device=device
        )
        for problem, observation in zip(many, observations, strict=True):
            problem.add(observation)
        return solve(many, progress)
    found: list[Estimate] = []
    for observation in observations:  # a problem at a time in memory
        (problem,) = light_problems(light, prior=prior, model=model, options=options, device=device)
        problem.add(observation)
        found += solve([problem])
        if progress is not None:
            progress(len(found) / len(observations))
    return found


def light_problems(
    light: Light,
    count: int = 1,
    *,
    prior: LightPrior | None = None,
    model: Model | None = None,
    options: SolverOptions | None = None,
    sun_priors: Sequence[SunPrior | None] | None = None,
    exposures: Sequence[float | None] | None = None,
    place: Place = "auto",
    device: str = "auto",
) -> Sequence[LightProblem]:
    """So many empty problems of one light model, for :func:`~skylight.inverse._problem.solve`.

    Each has a light and, where given, a prior and an exposure of its own. The other parameters are
    those of :func:`estimate_light`.
    """
    sun_priors = sun_priors or [None] * count
    exposures = exposures or [None] * count
    where, options = choose_device(device), options or SolverOptions()
    light = light_there(light, place, model=model)
    check_goes_together(light, prior, model)
    if any(one is not None for one in sun_priors) and not follows_clock(light, prior):
        raise InputError(
            "lamps are not the sun, nor is light of the whole sphere of your own: leave sun_prior "
            f"out, or choose another light than {name_of(light)}"
        )
    modes, skin = SkinPrior.load().means.float().to(where), albedo_prior().to(where)
    lamps = LampsOptions(weights=options.weights)
    degree = _degree(light, prior)
    if degree is not None:
        harmonics = HarmonicLight(degree).to(where)
        return [HarmonicProblem(harmonics, skin, modes, one) for one in sun_priors]
    if light == "sphere":
        places = None if model is None else load_model(model)
        assert not isinstance(places, LightBundle)  # check_goes_together
        return [
            sphere_problem(skin, modes, lamps, place, exposure, one, options.ground, places)
            for exposure, one in zip(exposures, sun_priors, strict=True)
        ]
    if light == "lamps":
        towards = towards_of(place)
        return [LampsProblem(skin, modes, lamps, towards=towards) for _ in sun_priors]
    if not isinstance(light, str):
        own, over = own_light(light, prior, where)
        if type(light) is LampsLight:
            family = replace(LAMPS, prior=lambda _count: over)
            return [LampsProblem(skin, modes, lamps, family, light.count) for _ in sun_priors]
        first = SkyProblem(own, over, skin, modes, options)
        return [first.another(one) for one in sun_priors]
    bundle = load_bundle() if model is None else load_model(model)
    assert isinstance(bundle, LightBundle)
    if light != "sunsky":
        sky, over = smooth_autoencoder(bundle), bundle.prior()
    else:
        sky, over = SunSky(), copy.deepcopy(bundle.sunsky_prior)
    if light == "auto":
        options = replace(options, evidence=True)
    first = SkyProblem(sky.to(where), over.to(where), skin, modes, options)
    skies = [first.another(one) for one in sun_priors]
    if light == "auto":
        return [
            AutoProblem(sky, LampsProblem(skin, modes, lamps), exposure)
            for sky, exposure in zip(skies, exposures, strict=True)
        ]
    return skies


def light_there(
    light: Light,
    place: Place,
    *,
    model: Model | None = None,
    solver: SolverName = DEFAULT_SOLVER,
) -> Light:
    """:func:`~skylight._names.light_at`, for which a model of one's own is chosen already.

    This is where it is said what only skies have: a trained ``model`` of them, and the thesis'
    ``solver``.
    """
    of_skies = "" if solver == DEFAULT_SOLVER else f"the solver {solver}"
    if model is not None and not is_of_places(model):
        of_skies = "a trained model of skies"
    if isinstance(light, str):
        return light_at(check_light_name(light), place, of_skies)
    if place != "auto":
        raise InputError(
            f"a place chooses a light model, and {called(light)} is one: leave place out"
        )
    return light


def _degree(light: Light, prior: LightPrior | None) -> int | None:
    """Of harmonics that are a linear problem; None of other light."""
    if isinstance(light, str):
        return {"sh9": 2, "sh25": 4}.get(light)
    return light.degree if is_linear(light, prior) else None


def check_goes_together(light: Light, prior: LightPrior | None, model: Model | None) -> None:
    """:class:`InputError` for what is no light, and a prior or a trained model that is not its."""
    if isinstance(light, str):
        check_light_name(light)
        if prior is not None:
            raise InputError(
                f"prior is for a light model of your own: {light} has its own, leave prior out"
            )
        if model is not None:
            check_is_trained(light, of_places=is_of_places(model))
        return
    check_light(light)
    if model is not None:
        raise InputError(
            f"model is for sphere, {', '.join(SKY_LIGHTS)}: {called(light)} is a model itself, "
            "leave it out"
        )


def smooth_autoencoder(bundle: LightBundle) -> AutoencoderLight:
    """A trained sky with its sun as wide as faces are fitted with, so that it turns smoothly."""
    return bundle.light(sun_spread_rad=SUN_SPREAD_RAD)


def albedo_prior() -> GaussianMixture:
    """The mixture over log albedo of skin, in single precision."""
    return copy.deepcopy(SkinPrior.load().log_albedo).float()
