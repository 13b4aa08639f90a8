"""An estimate as estimate.json and as lines for the terminal."""

import math
import platform
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version

from skylight.app.estimate.types import PhotoEstimate, SeenFace
from skylight.app.estimate.uncertainty import describe_posterior, sure_of_the_sun
from skylight.app.figures.angles import angles_deg, describe_lamps, named_angles
from skylight.imaging.taken import Taken
from skylight.inverse.result import Estimate, FaceLight

PACKAGES = ("skylight", "torch", "numpy", "scipy", "dlib-bin", "onnxruntime", "embreex")


def describe(result: PhotoEstimate, *, keep_place: bool) -> dict[str, object]:
    """What estimate.json holds; ``skylight relight --latent`` reads the autoencoder's."""
    estimate = result.estimate
    return {
        "sources": list(result.names),
        "light": estimate.light,
        "frame": "the camera looks along -Z, the centre of the map; +X is the picture's right, "
        "+Y up; azimuth from -Z towards +X, zenith from +Y; linear Rec.709",
        "choice": None if estimate.choice is None else asdict(estimate.choice),
        "sun": named_angles(estimate.sun_direction),
        "lamps": describe_lamps(estimate.lamps),
        "posterior": describe_posterior(estimate.posterior),
        "ground_albedo": estimate.ground_albedo.tolist(),
        "params": estimate.params.tolist(),
        "exposure": estimate.exposure,
        "white_balance": estimate.white_balance.tolist(),
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


def _describe_taken(taken: Taken) -> dict[str, object]:
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
        "gloss": light.gloss,
        "exposure": light.exposure,
        "white_balance": light.white_balance.tolist(),
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


def where(azimuth_deg: float, zenith_deg: float) -> str:
    """A direction in words, as the photographer would point: "behind, left, high"."""
    if zenith_deg < 15:
        return "overhead"
    height = "high" if zenith_deg < 40 else "low" if zenith_deg > 70 else "half high"
    turned = abs(azimuth_deg)
    depth = "ahead" if turned < 67.5 else "behind" if turned > 112.5 else ""
    side = "" if turned < 22.5 or turned > 157.5 else "left" if azimuth_deg < 0 else "right"
    return ", ".join(part for part in (depth, side, height) if part)


def _versions() -> dict[str, str | None]:
    found: dict[str, str | None] = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:  # the same modules, installed under another name
            found[package] = None
    return found


def _scene(estimate: Estimate) -> list[str]:
    """What light it is, where that was to be found out."""
    if estimate.choice is None:
        return []
    sure = round(100 * estimate.choice.probability)
    return [f"{'light':<12}{estimate.choice.scene} ({sure} % sure, as '{estimate.light}')"]


def _further_lamps(estimate: Estimate) -> list[str]:
    """Where those are that are not the strongest."""
    places = (angles_deg(lamp.direction) for lamp in estimate.lamps[1:])
    return [
        f"{'lamp':<12}another at azimuth {azimuth_deg:+.0f}°, zenith {zenith_deg:.0f}° "
        f"({where(azimuth_deg, zenith_deg)})"
        for azimuth_deg, zenith_deg in places
    ]


def summary(result: PhotoEstimate) -> str:
    """A few lines for the terminal."""
    estimate = result.estimate
    azimuth_deg, zenith_deg = angles_deg(estimate.sun_direction)
    name = "lamp" if estimate.light == "lamps" else "sun"
    count = len(estimate.faces)
    labels = ["face"] if count == 1 else [f"face {n}" for n in range(1, count + 1)]
    return "\n".join(
        [
            *_scene(estimate),
            f"brightest   azimuth {azimuth_deg:+.0f}°, zenith {zenith_deg:.0f}° "
            f"({where(azimuth_deg, zenith_deg)})",
            f"{name:<12}{sure_of_the_sun(estimate.posterior)}",
            *_further_lamps(estimate),
            f"verdict     {estimate.posterior.verdict}",
            *(
                f"{label:<12}re-rendered to within {100 * face.residual:.0f} % on average"
                for label, face in zip(labels, estimate.faces, strict=True)
            ),
            f"solver      {estimate.status} after {sum(result.seconds.values()):.0f} s",
        ]
    )
