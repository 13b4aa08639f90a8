"""JSON files of sky latents; without torch."""

import reprlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from skylight.errors import InputError
from skylight.io.bounded import json_content

LATENT = 64  # of the decoder that ships
_OTHER_DECODER = "0.1."  # versions of skylight whose estimates are latents of another decoder


@dataclass(frozen=True, kw_only=True)
class Latent:
    """Latents of a sky, and what the file says about the rest of the light."""

    z: Float32[np.ndarray, " z"]
    azimuth_rad: float = 0.0
    exposure: float | None = None
    ground_albedo: tuple[float, float, float] | None = None


def read_latent(path: str | Path, count: int = LATENT) -> Latent:
    """A JSON file as :func:`skylight.relight.runtime.relight_files` describes it, of so many
    latents."""
    path = Path(path)
    try:
        content = json_content(path)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}; give a JSON file") from error
    except ValueError as error:
        raise InputError(f"{path}: no JSON ({error})") from error
    if isinstance(content, list):
        content = {"latent": content}
    if not isinstance(content, dict) or not {"latent", "params"} & content.keys():
        raise InputError(f'{path}: expected {count} numbers, or an object with "latent"')
    if content.get("light", "autoencoder") != "autoencoder":
        raise InputError(
            f"{path}: the estimate of another light model ({content['light']}); estimate with the "
            "autoencoder, or relight with the estimate's light probe"
        )
    version = _version_of(content)
    if version.startswith(_OTHER_DECODER):
        raise InputError(
            f"{path}: estimated by skylight {version}, whose sky decoder was another; relight with "
            "the probe.exr beside it, or estimate again"
        )
    if "latent" in content:
        values = _numbers(path, "latent", content["latent"], count)
    else:
        values = _numbers(path, "params", content["params"], count + 1)
    exposure, ground = None, None
    if content.get("exposure") is not None:
        (exposure,) = _numbers(path, "exposure", [content["exposure"]], 1)
        if exposure <= 0:
            raise InputError(f'{path}: "exposure" must be above 0, got {exposure}')
    if content.get("ground_albedo") is not None:
        red, green, blue = ground = _numbers(path, "ground_albedo", content["ground_albedo"], 3)
        if not all(0 <= value <= 1 for value in ground):
            raise InputError(f'{path}: "ground_albedo" must be from 0 to 1, got {ground}')
        ground = red, green, blue
    return Latent(
        z=np.array(values[:count], np.float32),
        azimuth_rad=values[count] if len(values) > count else 0.0,
        exposure=exposure,
        ground_albedo=ground,
    )


def _version_of(content: Mapping[str, object]) -> str:
    """Of skylight, in an estimate.json; "" elsewhere."""
    versions = content.get("versions")
    version = versions.get("skylight") if isinstance(versions, dict) else None
    return version if isinstance(version, str) else ""


def _is_number(value: object) -> bool:
    """A number that float32 can hold."""
    limit = 3.4e38
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < limit


def _numbers(path: Path, name: str, values: object, count: int) -> list[float]:
    """``count`` finite numbers, or an :class:`InputError` that says what is there instead."""
    if not isinstance(values, list) or len(values) != count:
        got = len(values) if isinstance(values, list) else f"a {type(values).__name__}"
        raise InputError(f'{path}: "{name}" must have {count} numbers, got {got}')
    for place, value in enumerate(values):
        if not _is_number(value):
            shown = reprlib.repr(value)
            raise InputError(
                f'{path}: "{name}" has no number for float32 at place {place}: {shown}'
            )
    return [float(value) for value in values]
