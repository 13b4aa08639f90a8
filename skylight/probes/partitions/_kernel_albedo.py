"""The albedo of a kernel's material, from one photo of it beside a surface of known reflectance."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from skylight.errors import InputError
from skylight.io._bounded import read_object, require_keys, write_json
from skylight.probes._chart import LEAST_LIGHT, MOST_CLIPPED, GreyLine, Rectangle, find_chart
from skylight.probes.cameras._live import read_picture
from skylight.probes.cameras._response import Response, load_response, saturated
from skylight.work._progress import Tell

USUAL = 0.8  # of white filament, where nobody says or measures it
_KIND, _FORMAT = "kernel albedo", 1
_BLOCKS = 4  # along each side of a patch, to tell how even it is
_LEAST_SIDE_PX = 2 * _BLOCKS
_UNSURE = 0.05  # standard error of an albedo, of itself


@dataclass(frozen=True, kw_only=True, eq=False)
class KernelAlbedo:
    """Linear Rec.709 ``rgb`` (3,), its standard ``error`` (3,), and the ``reference`` target."""

    rgb: Float[Tensor, "3"]
    error: Float[Tensor, "3"]
    reference: str

    def __post_init__(self) -> None:
        if not bool(((self.rgb > 0) & (self.rgb <= 1)).all()):
            values = ", ".join(f"{value:.3g}" for value in self.rgb)
            raise InputError(f"an albedo is above 0 and at most 1, not ({values})")
        if not bool((self.error.isfinite() & (self.error >= 0)).all()):
            raise InputError("an albedo's error must be finite and 0 or more")


def measure_albedo(
    photo: Path,
    out: Path,
    *,
    patch: Rectangle,
    card: Rectangle | None,
    card_albedo: float | None,
    response: Path | None,
    warn: Tell = print,
) -> KernelAlbedo:
    """Write ``out`` (.json): the albedo of a ``patch``, against a card or a ColorChecker."""
    if (card is None) != (card_albedo is None):
        raise InputError("give --card and --card-albedo together, or neither with a ColorChecker")
    curve = Response() if response is None else load_response(response)
    image = read_picture(photo).image
    if card is None or card_albedo is None:
        found = albedo_beside_chart(image, curve, patch)
    else:
        found = albedo_beside_card(image, curve, patch, card, card_albedo)
    save_albedo(out, found)
    worst = float((found.error / found.rgb).max())
    if worst > _UNSURE:
        warn(
            f"the albedo is known to {worst:.0%} only: light it evenly, and check the response "
            "and the rectangles"
        )
    return found


def albedo_beside_card(
    photo: UInt8[np.ndarray, "h w 3"],
    response: Response,
    patch: Rectangle,
    card: Rectangle,
    card_albedo: float,
) -> KernelAlbedo:
    """From rectangles (x, y, width, height in px) of the material and of a grey card beside it.

    ``rho = rho_card s / s_card`` for Lambertian surfaces side by side. Errors are those of the
    means, by how much 4 x 4 blocks of each rectangle differ.
    """
    if not 0 < card_albedo <= 1:
        raise InputError(f"a card's albedo is above 0 and at most 1, got {card_albedo:g}")
    light, burnt = response.linearise(photo).numpy(), saturated(photo)
    here, here_error = _mean_of(light, burnt, patch, "patch")
    there, there_error = _mean_of(light, burnt, card, "card")
    if there.min() < LEAST_LIGHT:
        raise InputError("the card is black in the photo: expose longer, or check its rectangle")
    rgb = card_albedo * here / there
    relative = np.hypot(here_error / np.maximum(here, 1e-9), there_error / there)
    return _compared(rgb, rgb * relative, "grey card")


def albedo_beside_chart(
    photo: UInt8[np.ndarray, "h w 3"], response: Response, patch: Rectangle
) -> KernelAlbedo:
    """From a ColorChecker in the photo and a rectangle (x, y, width, height) of the material.

    A straight line through the five greys, ``s = a + k rho`` in each colour, tells the light k and
    what stray light adds, and ``rho = (s - a) / k``. The error is that of a value read off a line
    with ordinary least squares.
    """
    light, burnt = response.linearise(photo).numpy(), saturated(photo)
    chart = find_chart(photo, ", or give --card and --card-albedo")
    line = GreyLine.through(*chart.greys(light, burnt))
    rgb, error = line.albedo(*_mean_of(light, burnt, patch, "patch"))
    return _compared(rgb, error, "ColorChecker")


def save_albedo(path: str | Path, albedo: KernelAlbedo) -> None:
    """Write it as JSON."""
    write_json(
        path,
        {
            "kind": _KIND,
            "format": _FORMAT,
            "albedo": albedo.rgb.tolist(),
            "standard_error": albedo.error.tolist(),
            "told_by": albedo.reference,
        },
    )


def read_albedo(source: str | None) -> KernelAlbedo:
    """From a number, or the name of a file that :func:`save_albedo` wrote; 0.8 from None."""
    if source is None:
        return _uniform(USUAL, "assumed")
    try:
        value = float(source)
    except ValueError:
        return _load(Path(source))
    return _uniform(value, "given")


def _uniform(value: float, reference: str) -> KernelAlbedo:
    rgb = torch.full((3,), value, dtype=torch.float64)
    return KernelAlbedo(rgb=rgb, error=torch.zeros_like(rgb), reference=reference)


def _compared(
    rgb: Float[np.ndarray, "3"], error: Float[np.ndarray, "3"], reference: str
) -> KernelAlbedo:
    try:
        return KernelAlbedo(
            rgb=torch.from_numpy(rgb), error=torch.from_numpy(error), reference=reference
        )
    except InputError as wrong:
        raise InputError(
            f"{wrong}: material and {reference} must lie side by side, in the same light and "
            "without specular reflection"
        ) from wrong


def _load(path: Path) -> KernelAlbedo:
    content = read_object(path, _KIND)
    require_keys(path, content, ["format", "albedo", "standard_error", "told_by"])
    if content["format"] != _FORMAT:
        raise InputError(f"{path}: of format {content['format']}, this program reads {_FORMAT}")
    try:
        rgb, error = (
            torch.from_numpy(np.array(content[name], dtype=np.float64).reshape(3))
            for name in ("albedo", "standard_error")
        )
        return KernelAlbedo(rgb=rgb, error=error, reference=str(content["told_by"]))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: an albedo is three numbers ({error})") from error


def _mean_of(
    light: Float[np.ndarray, "h w 3"],
    burnt: Bool[np.ndarray, "h w"],
    rectangle: Rectangle,
    name: str,
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """(mean, its standard error) of a rectangle."""
    x, y, width, height = rectangle
    rows, columns = light.shape[:2]
    if x < 0 or y < 0 or x + width > columns or y + height > rows:
        raise InputError(
            f"{name} {x} {y} {width} {height} (x, y, width, height) leaves the photo, which is "
            f"{columns}x{rows}"
        )
    if min(width, height) < _LEAST_SIDE_PX:
        raise InputError(f"the {name} must be {_LEAST_SIDE_PX} pixels wide and high or more")
    there = np.s_[y : y + height, x : x + width]
    if burnt[there].mean() > MOST_CLIPPED:
        raise InputError(f"the {name} is over-exposed: expose shorter")
    blocks = np.array(
        [
            block.mean((0, 1), dtype=np.float64)
            for band in np.array_split(light[there], _BLOCKS, axis=0)
            for block in np.array_split(band, _BLOCKS, axis=1)
        ]
    )
    return blocks.mean(0), blocks.std(0, ddof=1) / _BLOCKS
