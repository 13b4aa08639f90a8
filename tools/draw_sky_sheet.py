"""Draws real skies and what light models make of them, as panoramas and as chrome balls.

python tools/draw_sky_sheet.py --data MAPS --before MODEL --out docs/images/sky_sheet.jpg

Each row is one map: the truth, the autoencoder of the folder ``--before``, the one that ships, and
spherical Gaussians of 63 numbers, all fitted as ``evaluate sky-representations`` does, under
the ground of albedo 0.2 that each would light. Every map is shown by the tone curve of its truth.
"""

import math
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import torch
import tyro
from jaxtyping import Float
from torch import Tensor

from skylight.evaluation._pictures import Picture, caption, sized
from skylight.evaluation._run import trained_light
from skylight.evaluation._sky_fits import over_ground
from skylight.evaluation._sky_models import KnownSkies
from skylight.evaluation._sky_representations import fit_autoencoder, fit_gaussians
from skylight.imaging._colour import tone_map
from skylight.sphere._envmap import bilinear, luminance
from skylight.sphere._frame import pixel_from_direction

TILE, MAPS, LOBES = 64, 24, 10


def chrome_ball(radiance: Float[Tensor, "h w 3"], size: int) -> Float[Tensor, "s s 3"]:
    """A mirror ball in that light, seen from far away straight ahead; white around it."""
    place = (torch.arange(3 * size) + 0.5) / (1.5 * size) - 1
    y, x = torch.meshgrid(-place, place, indexing="ij")
    inside = x**2 + y**2 < 1
    z = (1 - x**2 - y**2).clamp(min=0).sqrt()
    # r = d - 2 <d, n> n of the view d = (0, 0, -1)
    mirrored = torch.stack([2 * z * x, 2 * z * y, 2 * z * z - 1], -1).double()
    row, column = pixel_from_direction(mirrored.reshape(-1, 3), *radiance.shape[:2])
    seen = bilinear(radiance, row, column).reshape(3 * size, 3 * size, 3)
    seen = torch.where(inside[..., None], seen, torch.full_like(seen, math.inf))
    return seen


def shown(sky: Float[Tensor, "h w 3"], white: float) -> Picture:
    """Panorama of the sky and chrome ball, side by side."""
    panorama = sized(tone_map(sky, white=white), 4 * TILE, TILE, smooth=True)
    whole = over_ground(sky, torch.full((3,), 0.2)).radiance
    ball = tone_map(chrome_ball(whole, TILE).clamp(max=1e6), white=white)
    return np.hstack([panorama, sized(ball, TILE, TILE), np.full((TILE, 8, 3), 255, np.uint8)])


def drawn(data: Path, before: Path, number: int) -> tuple[str, Picture]:
    torch.set_num_threads(1)
    skies = KnownSkies(count=1000, seed=0, data=data)
    sky = skies.sky(number).radiance
    white = float(torch.quantile(luminance(sky), 0.98))
    made = [
        sky,
        fit_autoencoder(trained_light(before), sky),
        fit_autoencoder(trained_light(None), sky),
        fit_gaussians(sky, LOBES),
    ]
    return skies.names()[number], np.hstack([shown(each.float(), white) for each in made])


def main(*, data: Path, before: Path, out: Path, workers: int = 2) -> None:
    count = len(KnownSkies(count=1000, seed=0, data=data).names())
    numbers = np.linspace(0, count - 1, MAPS).round().astype(int).tolist()
    with ProcessPoolExecutor(workers) as pool:
        rows = list(pool.map(partial(drawn, data, before), numbers))
    titles = ("map", "autoencoder before, 65 numbers", "autoencoder, 65", "Gaussians, 63")
    width = rows[0][1].shape[1] // len(titles)
    strips = [np.hstack([caption(title, width) for title in titles])]
    for name, picture in rows:
        strips += [caption(name, picture.shape[1]), picture]
    cv2.imwrite(str(out), np.vstack(strips)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])


if __name__ == "__main__":
    tyro.cli(main)
