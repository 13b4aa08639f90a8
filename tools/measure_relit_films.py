"""How steady a relit film is, beside its frames relit each by itself.

    python -m tools.measure_relit_films --frames 6

A photograph (scikit-image's astronaut) is moved by known warps, each frame with noise of its own
and codes of 8 bits. The film is relit by the film's light, and every frame as a photograph. As the
warps are known, so is what of a frame's change is the film's own. What is left (:func:`changes`) is
told as ``..._change``, the mean over blocks of the person, which noise and the resampling of edges
are a part of, and as ``..._flicker``, that of the mean over the whole face: means over pairs of
frames. Goes on where it was stopped, at the same commit.
"""

import argparse
import statistics
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray
from PIL import Image
from skimage.data import astronaut

from skylight.estimation._kept import KeptFace
from skylight.estimation._photos import estimate_photo
from skylight.estimation._settings import EstimateSettings
from skylight.estimation.film._estimate import FilmSettings
from skylight.estimation.film._results import relightable
from skylight.evaluation._main import commit
from skylight.imaging._film import film_frames
from skylight.imaging._film_writer import written_film
from skylight.imaging._photo import read_codes
from skylight.io._atomic import atomic_path
from skylight.io._files import write_png
from skylight.portrait._files import relit_portrait, shown
from skylight.portrait._film import relight_film
from skylight.portrait._keys import key_light
from skylight.work._progress import silent
from skylight.work._resumable import SETTINGS, keep_settings
from tools.measured import write_measured

RATE, NOISE = 25.0, 1.5  # frames a second; codes, standard deviation
TURN_DEG, SHIFT_PX, ZOOM = 3.0, 8.0, 0.02  # to either side, in PERIOD frames
PERIOD = 24
FACE_PX = 176, 72, 120, 104  # left, top, width and height of the astronaut's face
SHEET_PX = 110, 10, 280  # left, top and side of what is shown
BLOCK_PX = 8  # of a block, whose mean counts: noise of single pixels is no flicker
_DARKEST = 0.01  # of white, in addition


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--folder", type=Path, default=Path("runs/relit_films"))
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/relit-films.json"))
    parser.add_argument("--sheet", type=Path, default=Path("docs/images/relit_film.jpg"))
    arguments = parser.parse_args()
    begun, folder = time.time(), arguments.folder
    folder.mkdir(parents=True, exist_ok=True)
    film = folder / "film.mkv"
    keep_settings(folder / SETTINGS, {"frames": arguments.frames, "commit": commit()})
    if not film.exists():  # files of the same frames differ
        write_moved(film, astronaut(), arguments.frames)
    kept = relightable(
        folder / "light", film, FilmSettings(estimate=EstimateSettings(device="cpu")), silent
    )
    together = folder / "film_left.mkv"
    started = time.process_time()
    relight_film(kept, {together: key_light(kept, "left")}, workers=1)
    processor_s = time.process_time() - started
    before = [frame.codes for frame in film_frames(film)]
    alone = [relit_alone(folder / f"{k:03d}.png", codes) for k, codes in enumerate(before)]
    facts = {"processor_s": processor_s}  # of all frames, and what is done once
    relit = [frame.codes for frame in film_frames(together)]
    for name, after in (("film", relit), ("frames", alone)):
        pairs = list(changes(before, after))
        facts[f"{name}_change"] = statistics.mean(change for change, _ in pairs)
        facts[f"{name}_flicker"] = statistics.mean(flicker for _, flicker in pairs)
    facts["flickers_less_by"] = facts["frames_flicker"] / facts["film_flicker"]
    write_sheet(arguments.sheet, before, relit)
    write_measured(
        arguments.out,
        name="relit-films",
        what=f"{arguments.frames} frames of a photograph that is moved, turned and enlarged by "
        "known warps, with a key light from the left",
        command=f"python -m tools.measure_relit_films --frames {arguments.frames}",
        begun=begun,
        facts=facts,
    )


def warp(k: int) -> Float[ndarray, "2 3"]:
    """From the photograph to frame k, in pixels of its astronaut."""
    at = 2 * np.pi * k / PERIOD
    matrix = cv2.getRotationMatrix2D(
        (230.0, 130.0), TURN_DEG * np.sin(at), 1 + ZOOM * np.sin(2 * at)
    )
    matrix[:, 2] += SHIFT_PX * np.sin(at), SHIFT_PX / 2 * np.sin(2 * at)
    return matrix


def write_moved(path: Path, photo: UInt8[ndarray, "h w 3"], frames: int) -> None:
    """The film, without loss."""
    rng, size = np.random.default_rng(0), photo.shape[1::-1]
    with written_film(path, RATE, (size[0], size[1])) as write:
        for k in range(frames):
            moved = cv2.warpAffine(
                photo, warp(k), size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
            )
            noisy = moved + rng.normal(0, NOISE, moved.shape)
            write(noisy.round().clip(0, 255).astype(np.uint8))


def relit_alone(path: Path, codes: UInt8[ndarray, "h w 3"]) -> UInt8[ndarray, "h w 3"]:
    """A frame as a photograph, kept in ``path``."""
    if not path.exists():
        kept = KeptFace.of(estimate_photo(codes, device="cpu"))
        write_png(path, shown(relit_portrait(kept, key_light(kept, "left"), keep="place")))
    return read_codes(path)


def changes(
    before: Sequence[UInt8[ndarray, "h w 3"]], after: Sequence[UInt8[ndarray, "h w 3"]]
) -> Iterator[tuple[float, float]]:
    """What of the relit frames' changes is not the film's own, of each pair: the mean over blocks
    of the person, and over the whole face, of ``ln(b_k / a_k) - W ln(b_(k-1) / a_(k-1))``.

    W is the true warp between the frames; light is codes' squared luminance. The mean over blocks
    is of absolute values, and of those where either frame was changed by 2 % or more.
    """
    gains = [_gain(a, b) for a, b in zip(before, after, strict=True)]
    for k in range(1, len(gains)):
        step = _whole(warp(k)) @ np.linalg.inv(_whole(warp(k - 1)))
        height, width = gains[k].shape
        border = np.ones((height, width), np.float32)
        last, there = (
            cv2.warpAffine(each, step[:2], (width, height)) for each in (gains[k - 1], border)
        )
        relit = np.maximum(np.abs(last), np.abs(gains[k])) > 0.02
        off = _blocks(gains[k] - last)
        person = (_blocks(there) > 0.999) & (_blocks(relit.astype(np.float32)) > 0.5)
        x, y, wide, high = (each // BLOCK_PX for each in FACE_PX)
        yield float(np.abs(off[person]).mean()), abs(float(off[y : y + high, x : x + wide].mean()))


def write_sheet(
    path: Path,
    before: Sequence[UInt8[ndarray, "h w 3"]],
    after: Sequence[UInt8[ndarray, "h w 3"]],
) -> None:
    """The heads of the frames, as they were and relit below."""
    left, top, side = SHEET_PX
    rows = [
        np.hstack([codes[top : top + side, left : left + side] for codes in film])
        for film in (before, after)
    ]
    sheet = Image.fromarray(np.vstack(rows))
    with atomic_path(path) as temporary:
        sheet.resize((sheet.width // 2, sheet.height // 2)).save(temporary, quality=90)


def _gain(before: UInt8[ndarray, "h w 3"], after: UInt8[ndarray, "h w 3"]) -> Float[ndarray, "h w"]:
    light = [
        cv2.blur(cv2.cvtColor(each, cv2.COLOR_RGB2GRAY).astype(np.float32) ** 2, (BLOCK_PX,) * 2)
        for each in (before, after)
    ]
    dark = _DARKEST * 255**2
    return np.log((light[1] + dark) / (light[0] + dark))


def _blocks(picture: Float[ndarray, "h w"]) -> Float[ndarray, "p q"]:
    height, width = (side // BLOCK_PX for side in picture.shape)
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)


def _whole(matrix: Float[ndarray, "2 3"]) -> Float[ndarray, "3 3"]:
    return np.vstack([matrix, [0, 0, 1]])


if __name__ == "__main__":
    main()
