"""The light in a photograph of an object of known shape: files in, files out."""

import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from skylight import __version__
from skylight._figures import (
    INK,
    MUTED,
    STYLE,
    angles_deg,
    describe_lamps,
    save,
    show,
    show_probe,
    white_of,
    write_numbers,
)
from skylight._names import ObjectLightName
from skylight.csc._positions import Positions
from skylight.errors import InputError
from skylight.imaging._colour import tone_map
from skylight.imaging._photo import Photo
from skylight.imaging._pictures import stored_picture
from skylight.imaging._preview import write_probe
from skylight.io._bounded import write_json
from skylight.object._problem import ObjectLight, estimate_object_light
from skylight.object._view import ObjectMaterial, ObjectView, observe_object
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import angles_from_direction
from skylight.transport._cameras import read_object_camera
from skylight.transport._mesh import read_mesh
from skylight.transport._render import Specular
from skylight.work._device import Device
from skylight.work._progress import StageProgress

REFLECTANCE = 0.04  # of plastics and varnish at normal incidence: index of refraction 1.5
_COUNTS = "no lamp", "one lamp", "two lamps", "three lamps"
_SHOWN_PIXELS = 20_000
_DIFFERENCE_GAIN = 4.0
_T = TypeVar("_T")


@dataclass(frozen=True, kw_only=True)
class KnownObjectEstimate:
    """A known object's picture and the light found, with the seconds that each step took."""

    view: ObjectView
    light: ObjectLight
    seconds: dict[str, float]


def estimate_known_object(
    mesh: Path,
    photo: Photo,
    camera: Path,
    *,
    light: ObjectLightName,
    activations: int = 50,
    device: Device = "auto",
    mask: Path | None = None,
    material: ObjectMaterial | None = None,
    progress: StageProgress | None = None,
) -> KnownObjectEstimate:
    """The light in which a mesh was photographed, in the mesh's world.

    ``camera`` is JSON (see :func:`skylight.transport._cameras.object_camera`), ``mask`` a
    picture that is bright where the object shows.

    Raises
    ------
    InputError
        A file cannot be used, or they do not fit together.
    """
    material = material or ObjectMaterial()
    tell = progress or (lambda _stage, _share: None)
    seconds: dict[str, float] = {}
    height, width = photo.pixels.shape[:2]
    placed = read_object_camera(camera, height=height, width=width)
    shown = None if mask is None else read_mask(mask)
    vertices, faces = _timed(seconds, "mesh", lambda: read_mesh(mesh))
    view = _timed(
        seconds,
        "transport",
        lambda: observe_object(
            vertices,
            faces,
            placed,
            photo.pixels,
            mask=shown,
            clipped=photo.clipped,
            material=material,
            progress=lambda share: tell("tracing light", share),
        ),
    )
    found = _timed(
        seconds,
        "light",
        lambda: estimate_object_light(
            view.observation,
            light,
            material=material,
            activations=activations,
            device=device,
            progress=lambda share: tell("looking for the light", share),
        ),
    )
    return KnownObjectEstimate(view=view, light=found, seconds=seconds)


def material_of(
    albedo: str | None, roughness: float | None, reflectance: float | None, bounces: int = 0
) -> ObjectMaterial:
    """The material that the command line's options describe; ``albedo`` is "r,g,b"."""
    colour = (1.0, 1.0, 1.0)
    if albedo is not None:
        try:
            r, g, b = (float(part) for part in albedo.split(","))
        except ValueError:
            raise InputError(
                f"--albedo must be three numbers such as 0.6,0.5,0.4, got {albedo!r}"
            ) from None
        colour = (r, g, b)
    if roughness is None:
        if reflectance is not None:
            raise InputError("--reflectance is that of a specular object: give --roughness as well")
        return ObjectMaterial(albedo=colour, bounces=bounces)
    f0 = REFLECTANCE if reflectance is None else reflectance
    specular = Specular(f0=f0, roughness=roughness)
    return ObjectMaterial(albedo=colour, specular=specular, bounces=bounces)


def read_mask(path: Path) -> Bool[Tensor, "h w"]:
    """True where a picture's codes, upright, are brighter than half of the largest (Rec.601)."""
    with stored_picture(path) as picture:
        codes = picture.codes()
    largest = 1.0 if codes.dtype == np.float32 else np.iinfo(codes.dtype).max
    return torch.from_numpy(codes @ np.array([0.299, 0.587, 0.114]) >= largest / 2)


CODES = re.compile(r"code\.json")  # what not every run writes


def write_object_results(
    folder: Path, result: KnownObjectEstimate, *, mesh: Path, photo: Path
) -> None:
    """probe.exr, probe.hdr, estimate.json, comparison.png and, of a sparse code, code.json."""
    write_probe(folder, result.light.environment)
    write_json(folder / "estimate.json", describe_object(result, mesh=str(mesh), photo=str(photo)))
    if result.light.code is not None:
        result.light.code.save(folder / "code.json")
    write_comparison(folder / "comparison.png", result, title=photo.name)


def describe_object(result: KnownObjectEstimate, *, mesh: str, photo: str) -> dict[str, object]:
    """What estimate.json holds."""
    light, view = result.light, result.view
    azimuth_deg, zenith_deg = brightest_deg(light.environment)
    placed, material = view.camera, view.material
    specular = material.specular
    content: dict[str, object] = {
        "source": photo,
        "mesh": mesh,
        "light": light.light,
        "frame": "the mesh's world: the map's centre looks along -Z, +X is a quarter turn to its "
        "right, +Y up; azimuth from -Z towards +X, zenith from +Y; linear Rec.709",
        "brightest": {"azimuth_deg": azimuth_deg, "zenith_deg": zenith_deg},
        "residual": light.residual,
        "linear_residual": light.linear_residual,
        "clamped_share": light.clamped_share,
        "lamps": describe_lamps(light.lamps),
        "advice": list(light.advice),
        "pixels_used": len(view.observation.pixels),
        "pixels_on_mesh": len(view.surface),
        "camera": {
            "width": placed.camera.width,
            "height": placed.camera.height,
            "focal_px": placed.camera.focal_px,
            "center_px": list(placed.camera.center_px),
            "world_from_camera": placed.world_from_camera.matrix().tolist(),
        },
        "material": {
            "albedo": list(material.albedo),
            "roughness": None if specular is None else specular.roughness,
            "reflectance": None if specular is None else specular.f0,
        },
        "seconds": result.seconds,
        "version": __version__,
        "seed": 0,  # draws which pixels are used
    }
    if light.coefficients is not None and light.code is None:
        content["coefficients"] = light.coefficients.tolist()
    if light.code is None:
        return content
    code, bank = light.code, light.dictionary
    assert bank is not None
    azimuth, zenith = (torch.rad2deg(a) for a in angles_from_direction(code.directions))
    places = Positions().places(code.rotations).tolist()
    content["dictionary"] = {
        "name": bank.name,
        "fingerprint": bank.fingerprint,
        "filters": len(bank),
        "degree": bank.degree,
    }
    content["code"] = [
        {
            "filter": int(code.filters[i]),
            "place": places[i],  # row, column, twist
            "azimuth_deg": float(azimuth[i]),
            "zenith_deg": float(zenith[i]),
            "rgb": code.weights[i].tolist(),
        }
        for i in range(len(code))
    ]
    return content


def summarise_object(result: KnownObjectEstimate) -> str:
    """A few lines for the terminal."""
    light = result.light
    azimuth_deg, zenith_deg = brightest_deg(light.environment)
    lamps = _lamps_deg(light)
    return "\n".join(
        [
            f"brightest   azimuth {azimuth_deg:+.0f}°, zenith {zenith_deg:.0f}° (mesh's world)",
            *(f"lamp        azimuth {a:+.0f}°, zenith {z:.0f}°" for a, z in lamps),
            f"object      re-rendered to within {100 * light.residual:.1f} %",
            f"light       {_kind(light)}, {100 * light.clamped_share:.1f} % cut off below zero",
            f"took        {sum(result.seconds.values()):.0f} s",
        ]
    )


def _kind(light: ObjectLight) -> str:
    """What the light is made of."""
    if light.light == "lamps":
        return f"{_COUNTS[len(light.lamps)]} in ambient light"
    return light.light if light.code is None else f"{len(light.code)} activations of {light.light}"


def _lamps_deg(light: ObjectLight) -> list[tuple[float, float]]:
    """(azimuth, zenith) of each."""
    return [angles_deg(lamp.direction) for lamp in light.lamps]


def brightest_deg(environment: EnvironmentMap) -> tuple[float, float]:
    """(azimuth, zenith) of the map's brightest pixel, above or below the horizon, degrees."""
    at = luminance(environment.flat).argmax()
    return angles_deg(environment.grid.directions[at])


def write_comparison(path: Path, result: KnownObjectEstimate, *, title: str) -> None:
    """The object as seen and re-rendered, their difference, and the light, as a PNG."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    light = result.light
    seen, rendered, difference = _side_by_side(result)
    white = white_of(result.view.observation.pixels)
    with rc_context(STYLE):
        figure = Figure(figsize=(15, 10), dpi=110, facecolor="white")
        figure.text(0.02, 0.96, f"Light of {title}", fontsize=17, fontweight="bold", color=INK)
        if light.advice:
            figure.text(0.02, 0.935, "Take care: " + "; ".join(light.advice), color=MUTED)
        rows = figure.add_gridspec(
            2, 1, height_ratios=(1, 1.15), left=0.02, right=0.98, top=0.9, bottom=0.05, hspace=0.12
        )
        above = rows[0].subgridspec(1, 3, wspace=0.05)
        pictures = {
            "As seen": seen,
            "Re-rendered in the light found": rendered,
            f"Difference × {_DIFFERENCE_GAIN:g}": _DIFFERENCE_GAIN * difference,
        }
        for i, (name, picture) in enumerate(pictures.items()):
            show(figure.add_subplot(above[i]), tone_map(picture, white=white), name)
        below = rows[1].subgridspec(1, 2, width_ratios=(3.2, 1), wspace=0.08)
        probe = figure.add_subplot(below[0])
        show_probe(probe, light.environment, "Light around the object, in the mesh's world")
        probe.set_xticks(probe.get_xticks(), ["+Z", "−X", "−Z", "+X", "+Z"])
        write_numbers(figure.add_subplot(below[1]), "In numbers", _rows(result))
        save(figure, path)


def _side_by_side(
    result: KnownObjectEstimate,
) -> tuple[Float[Tensor, "h w 3"], Float[Tensor, "h w 3"], Float[Tensor, "h w 3"]]:
    """(seen, re-rendered over the picture in dimmed grey, |difference| on the object), cut out.

    Of a large object every second, third, ... pixel is shown, up to about 20,000.
    """
    surface, picture = result.view.surface, result.view.picture.float()
    step = max(1, round((len(surface) / _SHOWN_PIXELS) ** 0.5))
    points = torch.nonzero((surface.pixels % step == 0).all(1))[:, 0]
    shade = result.view.shade(result.light.environment, points)
    rows, columns = (surface.pixels[points] // step).unbind(1)
    seen = picture[::step, ::step]
    rendered = (0.35 * luminance(seen))[..., None].repeat(1, 1, 3)
    rendered[rows, columns] = shade
    difference = torch.zeros_like(seen)
    difference[rows, columns] = (shade - seen[rows, columns]).abs()
    margin = 2 + int(max(rows.max() - rows.min(), columns.max() - columns.min())) // 15
    window = (
        slice(max(0, int(rows.min()) - margin), int(rows.max()) + margin + 1),
        slice(max(0, int(columns.min()) - margin), int(columns.max()) + margin + 1),
    )
    return seen[window], rendered[window], difference[window]


def _rows(result: KnownObjectEstimate) -> list[tuple[str, str]]:
    light = result.light
    azimuth_deg, zenith_deg = brightest_deg(light.environment)
    return [
        ("light", _kind(light)),
        ("brightest: azimuth, −Z to +X", f"{azimuth_deg:+.0f}°"),
        ("   zenith angle", f"{zenith_deg:.0f}°"),
        *(
            (f"lamp {k}: azimuth, zenith", f"{azimuth:+.0f}°, {zenith:.0f}°")
            for k, (azimuth, zenith) in enumerate(_lamps_deg(light), start=1)
        ),
        ("residual", f"{100 * light.residual:.1f} %"),
        ("cut off below zero", f"{100 * light.clamped_share:.1f} %"),
        ("pixels used", f"{len(result.view.observation.pixels)}"),
        *((f"   {name}, s", f"{value:.1f}") for name, value in result.seconds.items()),
    ]


def _timed(seconds: dict[str, float], name: str, work: Callable[[], _T]) -> _T:
    start = time.perf_counter()
    out = work()
    seconds[name] = time.perf_counter() - start
    return out
