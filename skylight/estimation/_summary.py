"""An estimate from photographs with its faces, and how it is told: estimate.json and the terminal.

How sure the light is, is told as numbers, as text, as an environment map, and as a contour.
"""

import math
import platform
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from contourpy import contour_generator
from jaxtyping import Float
from torch import Tensor

from skylight import __version__
from skylight._figures import angles_deg, describe_lamps, named_angles
from skylight._names import DetailName
from skylight.estimation._detail import detailed
from skylight.estimation._lights import lights_apart
from skylight.faces._fit import FaceFit
from skylight.faces._landmarks import DetectedFace
from skylight.faces._observe import FaceView
from skylight.imaging._capture_metadata import CaptureMetadata
from skylight.imaging._colour import Decode
from skylight.imaging._exposure import CameraExposure
from skylight.imaging._photo import Photo
from skylight.inverse._posterior import SHARE, SunPosterior
from skylight.inverse._result import Estimate, FaceLight
from skylight.inverse._scan import SCAN_HEIGHT
from skylight.inverse._verdict import Verdict, place
from skylight.sphere._envmap import EnvironmentMap

if TYPE_CHECKING:
    from matplotlib.axes import Axes


# Of transport once the solver has taken what it needs: as many as lamps are found on, so that the
# faces can be seen under other ones.
KEPT_ROWS = SCAN_HEIGHT


@dataclass(frozen=True, kw_only=True)
class SeenFace:
    """Face ``number`` (1 is the largest) of photograph ``photo``, counted from 0, named ``name``.

    Harmonics have coarser transport than skies, without specular reflection: a sky cannot be fitted
    to it. Where several heads were fitted, ``view.observation`` keeps its transport on
    :data:`KEPT_ROWS` rows only.
    """

    photo: int
    number: int
    name: str
    face: DetectedFace
    fit: FaceFit
    view: FaceView

    def on_fewer_rows(self) -> "SeenFace":
        """With transport on :data:`KEPT_ROWS` rows, a quarter of the memory of a sky's."""
        observation = self.view.observation.on_rows(KEPT_ROWS)
        return replace(self, view=replace(self.view, observation=observation))


@dataclass(frozen=True, kw_only=True)
class PhotoEstimate:
    """The estimate with everything on the way to it; ``seconds`` per stage.

    ``photos`` and their ``names`` are all that were given; ``seen`` holds the faces of
    ``estimate.faces``, in their order; ``face``, ``fit`` and ``view`` are the first one's.
    ``taken`` is what was known of time, place and heading, which results do not repeat. ``detail``
    is what ``probe`` shows beside the light. ``files`` are the photographs', None for those that
    were given in memory, and ``decode`` is how they were read.
    """

    estimate: Estimate
    photos: tuple[Photo, ...]
    names: tuple[str, ...]
    seen: tuple[SeenFace, ...]
    taken: CaptureMetadata
    seconds: dict[str, float] = field(default_factory=dict)
    detail: DetailName = "none"
    files: tuple[Path | None, ...] = ()
    decode: Decode | None = None

    @cached_property
    def probe(self) -> EnvironmentMap:
        """The estimate's map as it is written, with the (first) photograph's detail."""
        if not self.seen or self.view.behind is None:
            return self.estimate.environment
        return detailed(self.estimate, self.view.behind, self.view.observation.grey, self.detail)

    @cached_property
    def lights(self) -> list[dict[str, object]]:
        """What estimate.json and probe.exr's header say of the sun or the lamps."""
        return describe_lights(self.estimate)

    @property
    def camera_exposure(self) -> CameraExposure | None:
        """That of the photograph whose units the map has, where its data tell."""
        return self.photos[self.seen[0].photo].camera_exposure if self.seen else None

    @property
    def face(self) -> DetectedFace:
        return self.seen[0].face

    @property
    def fit(self) -> FaceFit:
        return self.seen[0].fit

    @property
    def view(self) -> FaceView:
        return self.seen[0].view


REGION = "#ffd23f"  # the line about the region


def describe_posterior(posterior: SunPosterior) -> dict[str, object]:
    """What estimate.json says of it; the density itself is in posterior.exr."""
    return {
        "is_seen": posterior.is_seen,
        "share": SHARE,
        "region_sr": posterior.region_sr,
        "region_radius_deg": math.degrees(posterior.region_radius_rad),
        "region_edge_per_sr": edge_density(posterior),
        "region_parts": [
            {"share": part.share, **named_angles(part.peak)}
            for part in posterior.parts
            if part.share >= 0.01
        ],
        "sun_gain": posterior.sun_gain,
        "clock_wrong": posterior.clock_wrong,
        "exposure_interval": list(posterior.exposure_interval),
        "albedo_scale_interval": list(posterior.albedo_scale_interval),
    }


def describe_verdict(verdict: Verdict) -> dict[str, object]:
    """What estimate.json says of it."""
    return {"summary": verdict.summary, **asdict(verdict)}


def edge_density(posterior: SunPosterior) -> float:
    """Density per sr along the line that pictures draw about the region.

    That is the region's least density moved by 2 %, since where much of the sky is that dense, its
    ripples of a thousandth would make edges all over; up or down, whichever encloses a share
    nearer to the region's. What is enclosed is then the region where the density falls off; 80 to
    90 % where a lobe in a flat sky holds a little less than 90 %; and all of a flat sky.
    """
    least = posterior.density[posterior.region].min()
    mass = posterior.density * posterior.grid.solid_angles

    def away(level: Float[Tensor, ""]) -> float:
        return abs(float(mass[posterior.density >= level].sum()) - SHARE)

    return float(min(0.98 * least, 1.02 * least, key=away))


def sure_of_the_sun(posterior: SunPosterior) -> str:
    """The 90 % region in words."""
    if not posterior.is_seen:
        even = "the face is lit evenly" if posterior.grid.is_sphere else "it may be overcast"
        return f"none for certain: {even}, or it is hidden behind the head"
    size = f"a circle of {math.degrees(posterior.region_radius_rad):.0f}° radius"
    parts = sum(part.share > 0.1 * SHARE for part in posterior.parts)
    area = size if parts < 2 else f"{parts} areas, together as large as {size}"
    return f"{100 * SHARE:.0f} % sure within {area}"


def probe_title(posterior: SunPosterior, verdict: Verdict) -> str:
    """What stands over a picture of the light."""
    title = f"Light: {verdict.summary}"
    if not posterior.is_seen:
        return title
    whose = "lamp's" if posterior.grid.is_sphere else "sun's"
    return f"{title} (yellow: the {whose} {100 * SHARE:.0f} % region)"


def posterior_map(posterior: SunPosterior) -> EnvironmentMap:
    """The density per sr as a grey lat-long map of 64 rows; of a sun 0 below the horizon."""
    assert posterior.grid.layout is not None
    density = posterior.density.reshape(posterior.grid.layout).float()
    if posterior.grid.is_sphere:
        grey = density.repeat_interleave(2, 0).repeat_interleave(2, 1)
    else:
        grey = torch.cat([density, torch.zeros_like(density)])
    return EnvironmentMap(radiance=grey[..., None].repeat(1, 1, 3))


def region_lines(posterior: SunPosterior, height: int) -> list[Float[np.ndarray, "k 2"]]:
    """The region's contour, (column, row) on a full lat-long picture of ``height`` rows; none
    where no sun is seen."""
    if not posterior.is_seen:
        return []
    density = posterior_map(posterior).radiance[..., 0].numpy()
    level = edge_density(posterior)
    # one column round the seam on either side, one row of nothing above the zenith's
    wrapped = np.pad(np.pad(density, ((0, 0), (1, 1)), mode="wrap"), ((1, 0), (0, 0)))
    rows, columns = (
        (np.arange(-1, end) + 0.5) * height / len(density) - 0.5
        for end in (len(density), density.shape[1] + 1)
    )
    return [np.asarray(line) for line in contour_generator(columns, rows, wrapped).lines(level)]


def draw_region(axes: "Axes", posterior: SunPosterior, height: int) -> None:
    """The region's contour on matplotlib's picture of a map of ``height`` rows."""
    limits = axes.axis()  # lines would widen them
    for line in region_lines(posterior, height):
        for color, width in (("black", 3.4), (REGION, 1.8)):
            axes.plot(*line.T, color=color, linewidth=width)
    axes.axis(limits)


def main_light(estimate: Estimate) -> str:
    """What to call the direction that is told first."""
    return "main light" if estimate.posterior.is_seen else "most light"


def has_ground(estimate: Estimate) -> bool:
    """A sky above a ground, of one albedo: light of the whole sphere has none."""
    return not estimate.posterior.grid.is_sphere


PACKAGES = ("torch", "numpy", "scipy", "dlib-bin", "onnxruntime", "embreex")


def describe(result: PhotoEstimate, *, keep_place: bool) -> dict[str, object]:
    """What estimate.json holds; ``skylight relight --latent`` reads the autoencoder's."""
    estimate, exposure = result.estimate, result.camera_exposure
    return {
        "sources": list(result.names),
        "light": estimate.light,
        "frame": "the camera looks along -Z, the centre of the map; +X is the picture's right, "
        "+Y up; azimuth from -Z towards +X, zenith from +Y; linear Rec.709",
        "choice": None if estimate.choice is None else asdict(estimate.choice),
        "kinds": estimate.kinds,
        "sun": named_angles(estimate.sun_direction),
        "lamps": describe_lamps(estimate.lamps),
        "lights": result.lights,
        "detail": result.detail,
        "verdict": describe_verdict(estimate.verdict),
        "posterior": describe_posterior(estimate.posterior),
        "ground_albedo": estimate.ground_albedo.tolist() if has_ground(estimate) else None,
        "params": estimate.params.tolist(),
        "luminance": None if exposure is None else exposure.described(),
        "exposure": estimate.exposure,
        "white_balance": estimate.white_balance.tolist(),
        "edit": asdict(estimate.faces[0].edit),
        "objective": {**estimate.terms, "total": math.fsum(estimate.terms.values())},
        "status": estimate.status,
        "advice": list(estimate.advice),
        "stats": estimate.stats,
        "faces": [
            _describe_face(seen, light, result.names[seen.photo])
            for seen, light in zip(result.seen, estimate.faces, strict=True)
        ],
        "seconds": result.seconds,
        "versions": _versions(),
        "seed": None,  # no step of an estimate draws random numbers
        **({"taken": _describe_taken(result.taken)} if keep_place else {}),
    }


def describe_lights(estimate: Estimate) -> list[dict[str, object]]:
    """The sun or the lamps, with their true size: what estimate.json and probe.exr's header say."""
    return [light.described() for light in lights_apart(estimate)[1]]


def _describe_taken(taken: CaptureMetadata) -> dict[str, object]:
    return {
        "time": None if taken.time is None else taken.time.isoformat(),
        "latitude_deg": taken.latitude_deg,
        "longitude_deg": taken.longitude_deg,
        "heading_deg": taken.heading_deg,
    }


def _describe_face(seen: SeenFace, light: FaceLight, source: str) -> dict[str, object]:
    fit, eye_distance_px = seen.fit, seen.face.eye_distance_px
    return {
        "source": source,
        "number": seen.number,
        "albedo": light.albedo.tolist(),
        "gloss": light.specular_scale,
        "exposure": light.exposure,
        "white_balance": light.white_balance.tolist(),
        "edit": asdict(light.edit),
        "residual": light.residual,
        "landmarker": "dlib" if seen.face.readings is None else "mediapipe",
        "landmark_score": seen.face.score,
        "landmark_error": fit.landmark_error,
        "landmark_error_px": fit.landmark_error * eye_distance_px,
        "outer_eye_distance_px": eye_distance_px,
        "facing_angle_deg": math.degrees(fit.facing_angle_rad),
        "focal_length_px": fit.camera.focal_px,
        "picture_px": [fit.camera.width, fit.camera.height],
        # metres, in the camera's frame: the head's own origin, mid-head at the height of the eyes
        "eyes": fit.translation.tolist(),
        "forward": fit.rotation[:, 2].tolist(),  # where the face looks, a unit vector
        "fit_converged": fit.converged,
        "pixels_used": len(seen.view.blocks),
    }


def _versions() -> dict[str, str | None]:
    found: dict[str, str | None] = {"python": platform.python_version(), "skylight": __version__}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:  # the same modules, installed under another name
            found[package] = None
    return found


def told_verdict(verdict: Verdict) -> list[str]:
    """What the light is, and how far to trust it."""
    if verdict.doubt:
        return [f"{'light':<12}{verdict.light}", f"{'verdict':<12}{verdict.summary}"]
    words = {
        "light": verdict.light,
        "direction": verdict.direction,
        "brightness": verdict.brightness,
        "colour": verdict.colour,
    }
    return [f"{name:<12}{each}" for name, each in words.items()]


def at(direction: Float[Tensor, "3"]) -> str:
    """A direction by its angles and in words."""
    azimuth_deg, zenith_deg = angles_deg(direction)
    return f"azimuth {azimuth_deg:+.0f}°, zenith {zenith_deg:.0f}° ({place(direction)})"


def _unit_in_words(exposure: CameraExposure | None) -> str:
    if exposure is None:
        return "unknown: the photograph's data lack exposure time, f-number or ISO"
    rounded = float(f"{exposure.cd_per_m2:.2g}")
    return f"1 in the map is about {rounded:g} cd/m², within a stop"


def summary(result: PhotoEstimate) -> str:
    """A few lines for the terminal."""
    estimate = result.estimate
    name = "lamp" if estimate.posterior.grid.is_sphere else "sun"
    count = len(estimate.faces)
    labels = ["face"] if count == 1 else [f"face {n}" for n in range(1, count + 1)]
    return "\n".join(
        [
            *told_verdict(estimate.verdict),
            *(
                [f"model       {estimate.light} ({100 * estimate.choice.probability:.0f} % sure)"]
                if estimate.choice
                else []
            ),
            *(f"place       {kind} (the likeliest kind)" for kind in list(estimate.kinds)[:1]),
            f"{main_light(estimate):<12}{at(estimate.sun_direction)}",
            f"{name:<12}{sure_of_the_sun(estimate.posterior)}",
            *(f"lamp        another at {at(lamp.direction)}" for lamp in estimate.lamps[1:]),
            *(
                f"{label:<12}re-rendered to within {100 * face.residual:.0f} % on average"
                for label, face in zip(labels, estimate.faces, strict=True)
            ),
            f"{'unit':<12}{_unit_in_words(result.camera_exposure)}",
            f"solver      {estimate.status} after {sum(result.seconds.values()):.0f} s",
        ]
    )
