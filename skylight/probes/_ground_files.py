"""The ground's albedo from photographs; files to files."""

import math
from pathlib import Path

import numpy as np
import torch

from skylight.errors import InputError
from skylight.imaging._colour import tone_map
from skylight.io._hdr import SUFFIXES as HDR_SUFFIXES
from skylight.models._ground import USUAL_SPREAD, KnownGround
from skylight.probes._chart import MeasuredGround, Rectangle, flat_field, measure_ground
from skylight.probes.cameras._exposure_files import read_exposure
from skylight.probes.cameras._response import SATURATED, Response, load_response, saturated
from skylight.work._progress import Tell

_UNSURE = 0.1  # relative error of an albedo


def ground_albedo(
    photo: Path,
    out: Path,
    *,
    flat: Path | None = None,
    region: Rectangle | None = None,
    response: Path | None = None,
    tell: Tell = print,
    warn: Tell = print,
) -> KnownGround:
    """Write ``out`` (.json): the ground's albedo by the ColorChecker that lies on it.

    ``flat`` is a photo of something even, by which vignetting is undone. The spread is what one
    place tells of the ground round it, a tenth, and the error.
    """
    if out.suffix.lower() != ".json":
        raise InputError(f"{out}: an albedo is written as .json; choose another name")
    curve = Response() if response is None else load_response(response)
    codes, light, burnt = _read(photo, curve)
    gain = None
    if flat is not None:
        _, even, over = _read(flat, curve)
        gain = flat_field(even, over)
    found = measure_ground(codes, light, burnt, region=region, gain=gain)
    error = float((found.error / np.maximum(found.rgb, 1e-6)).max())
    red, green, blue = found.rgb.tolist()
    try:
        ground = KnownGround(
            albedo=(red, green, blue), spread=min(2.0, math.hypot(USUAL_SPREAD, error))
        )
    except InputError as wrong:
        raise InputError(
            f"{photo}: {wrong}; chart and ground must lie flat in the same light, without specular "
            "reflection"
        ) from wrong
    ground.save(out, _facts(found, photo, flat))
    if error > _UNSURE:
        warn(
            f"the albedo is known to {error:.0%} only: see that chart and ground are lit alike, "
            "and check the response"
        )
    told = ", ".join(f"{v:.3f} +- {e:.3f}" for v, e in zip(found.rgb, found.error, strict=True))
    tell(
        f"{out}: albedo {told} (red, green, blue) of {found.share:.0%} of the photo; "
        f"--ground-albedo {ground.option()}"
    )
    return ground


def _facts(found: MeasuredGround, photo: Path, flat: Path | None) -> dict[str, object]:
    return {
        "standard_error": found.error.tolist(),
        "share_of_photo": found.share,
        "photo": str(photo),
        "flat_field": None if flat is None else str(flat),
    }


def _read(path: Path, response: Response) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(8-bit sRGB codes, linear light, where it is saturated) of a picture or RAW file."""
    image = read_exposure(path, response)
    if image.dtype == np.uint8:
        return image, response.linearise(image).numpy(), saturated(image)
    burnt = image.max(-1) >= (np.inf if path.suffix.lower() in HDR_SUFFIXES else SATURATED)
    return tone_map(torch.from_numpy(image)), image, burnt
