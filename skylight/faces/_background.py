"""The background of a photograph: which pixels show it, and the observation of the light it makes.

People are cut out with a margin (:func:`~skylight.faces._segmentation.person_matte` of each fitted
head), and what stands below them too: arms and clothes. What was drawn rather than photographed is
found by being *exactly* even, which no sensor is: frames and bars, the white about a round crop or
a cut-out. Whatever lies beyond the straight seam of a collage is left out too. The rest is averaged
over blocks of some degrees; the camera is that of the fitted head, and level.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Int, Shaped, UInt8
from numpy import ndarray
from torch import Tensor

from skylight.errors import InputError
from skylight.faces._bust import bust
from skylight.faces._fit import FaceFit
from skylight.faces._model import HeadModel, Region
from skylight.faces._segmentation import person_matte
from skylight.imaging._colour import linear_to_srgb
from skylight.sphere._envmap import luminance
from skylight.sphere._frame import DirectionGrid, pixel_from_direction
from skylight.transport._background import Background
from skylight.transport._cameras import Camera
from skylight.transport._matrix import TransportMatrix

LONG_SIDE_PX = 160  # of the small picture that is looked at: pixels of 0.2 to 0.5 degrees
BLOCK_RAD = math.radians(8.0)  # half as wide again as a cell of 32 rows
MOST_BLOCKS = 8, 6  # across and down
LEAST_OF_BLOCK = 0.25  # of a block's pixels show background, else it is left out
FEWEST_BLOCKS = 3
# Of the person, who may show through so much of a pixel, and the margin for hair and defocus, in
# heights of the face
LEAST_MATTE, MARGIN = 0.1, 0.12
CLIPPED_SHARE = 0.02  # of a block's pixels, beyond which its mean is a lower bound
# Darker than this part of the face, by so much of the picture: a black studio, or night behind a
# flash. Of one colour: by so little in log luminance and in log colour.
BLACK, BLACK_SHARE = 0.02, 0.8
PLAIN = 0.05
FLAT_SHARE = 0.9  # of a small pixel is exactly even: drawn
SAME_CODES = 6  # drawn parts of one colour differ by less
SOFT_CODES = 25  # below white, beside what was white to the sensor
SEAM_CODES, SEAM_SHARE = 16, 0.85  # a step of so much along so much of a line: a collage's seam
# Plants fill so much of what stands behind people in gardens, seldom in rooms; a sky its upper half
SEEN_SHARE, GREEN, LEAFY, SKY = 0.25, 0.05, 0.4, 1.0
_LEAST = 1e-4  # of radiance against the face's, before logarithms


@dataclass(frozen=True, kw_only=True)
class BackgroundPixels:
    """A small linear ``picture`` of a photograph, and where it shows what stands behind the people.

    ``usable`` are pixels that show neither people, with a margin, nor what was drawn or belongs to
    another photograph; ``clipped`` is the share of each pixel that is over-exposed.
    """

    picture: Float[ndarray, "p q 3"]
    clipped: Float[ndarray, "p q"]
    usable: Bool[ndarray, "p q"]
    camera: Camera

    @staticmethod
    def of(
        picture: Float[Tensor, "h w 3"],
        clipped: Bool[Tensor, "h w"],
        fits: Sequence[FaceFit],
        hair: Float[ndarray, "h w"],
    ) -> "BackgroundPixels":
        """Of a linear photograph of people whose heads were fitted; the first one's camera counts.

        ``hair`` is how likely a pixel shows hair.

        Raises
        ------
        InputError
            Too little of it is seen, or it was drawn.
        """
        full = picture.numpy()
        seen, hair = _small(full), _small(hair)
        codes = (255 * linear_to_srgb(torch.from_numpy(seen).clamp(0, 1))).round().byte().numpy()
        cameras = [fit.camera.resized(*seen.shape[1::-1]) for fit in fits]
        people, faces = np.zeros(seen.shape[:2], bool), np.zeros(seen.shape[:2], bool)
        for fit, camera in zip(fits, cameras, strict=True):
            person, face = _person(fit, camera, codes, hair)
            people, faces = people | person, faces | face
        drawn = _drawn(codes, _even(full), people)
        usable = ~(people | drawn | _beyond_seams(codes, faces))
        needed = FEWEST_BLOCKS * LEAST_OF_BLOCK / math.prod(MOST_BLOCKS)
        if (usable | drawn).mean() < needed:
            raise InputError("too little of it is seen beside the person")
        if usable.mean() < max(needed, 0.1 * (usable | drawn).mean()):
            raise InputError("it is of one even colour, drawn rather than photographed")
        return BackgroundPixels(
            picture=seen,
            clipped=_small(clipped.float().numpy()),
            usable=usable,
            camera=cameras[0],
        )

    def observed(self, face_level: float, grid_height: int) -> Background:
        """Its light, on the directions of a lat-long grid of ``grid_height`` rows.

        ``face_level`` is the mean luminance of the face.

        Raises
        ------
        InputError
            It is black, white or of one colour: it tells nothing of the light.
        """
        light = np.maximum(self.picture[self.usable] / max(face_level, 1e-9), _LEAST)
        bright = luminance(torch.from_numpy(light)).numpy()
        if (bright < BLACK).mean() > BLACK_SHARE:
            raise InputError("it is black, as in a studio or behind a flash at night")
        contrast = float(np.log(bright).std())
        if max(contrast, *(np.log(light[:, [0, 2]] / light[:, 1:2]).std(0))) < PLAIN:
            raise InputError("it is of one colour, as a backdrop or a screen is")
        upper = np.nonzero(self.usable)[0] < len(self.usable) / 2
        outdoors = _outdoors(self.picture[self.usable], bright, upper, contrast)
        return replace(_in_blocks(self, contrast, grid_height), outdoors=outdoors)


def _outdoors(
    picture: Float[ndarray, "u 3"],
    bright: Float[ndarray, " u"],
    upper: Bool[ndarray, " u"],
    contrast: float,
) -> bool:
    """Whether linear pixels, so ``bright`` relative to the face, show plants or a blue sky, by day.

    Plants are green by the excess green index ``2 g - r - b`` of sRGB chromaticities (Woebbecke et
    al. 1995), and uneven. A painted wall behind other things is taken for them.
    """
    codes = linear_to_srgb(torch.from_numpy(picture).clamp(0, 1)).numpy()
    red, green, blue = (codes / np.maximum(codes.sum(1, keepdims=True), 1e-6)).T
    plants = (2 * green - red - blue > GREEN) & (bright > BLACK) & (contrast > LEAFY)
    sky = (blue > 1.05 * green) & (green > red) & (bright > SKY)
    shares = plants.mean(), sky[upper].mean() if upper.any() else 0.0
    return bool(max(shares) > SEEN_SHARE)


def _in_blocks(pixels: BackgroundPixels, contrast: float, grid_height: int) -> Background:
    """Means over the usable pixels of each block that has enough of them."""
    usable, camera = pixels.usable, pixels.camera
    height, width = usable.shape
    down, across = (
        min(most, max(2, round(2 * math.atan(side / 2 / camera.focal_px) / BLOCK_RAD)))
        for side, most in zip((height, width), MOST_BLOCKS[::-1], strict=True)
    )
    rows, columns = np.indices(usable.shape)
    block = (rows * down // height) * across + columns * across // width
    whole = np.bincount(block.ravel(), minlength=down * across)
    count = np.bincount(block[usable], minlength=down * across)
    kept = np.flatnonzero(count >= np.maximum(LEAST_OF_BLOCK * whole, 1))
    if len(kept) < FEWEST_BLOCKS:
        raise InputError("too little of it is seen beside the person")
    grid = DirectionGrid.latlong(grid_height)
    assert grid.layout is not None
    at = pixel_from_direction(camera.rays().reshape(height, width, 3), *grid.layout)
    row, column = (each.round().long().numpy() for each in at)
    cell = row.clip(0, grid.layout[0] - 1) * grid.layout[1] + column % grid.layout[1]
    number = np.full(down * across, -1)
    number[kept] = np.arange(len(kept))
    used = usable & (number[block] >= 0)
    index = torch.from_numpy(number[block[used]])
    share = torch.from_numpy(1 / count[kept])[index]

    def means(values: Float[Tensor, "u c"]) -> Float[Tensor, "k c"]:
        total = torch.zeros(len(kept), values.shape[1], dtype=torch.float64)
        return total.index_add_(0, index, share[:, None] * values)

    bounds = means(torch.from_numpy(pixels.clipped[used])[:, None])[:, 0] > CLIPPED_SHARE
    if bool(bounds.all()):  # all that is known is that it is brighter than the rest of the place
        raise InputError("it is over-exposed all over")
    averages = torch.zeros(len(kept), len(grid), dtype=torch.float64)
    averages.index_put_((index, torch.from_numpy(cell[used])), share, accumulate=True)
    return Background(
        radiance=means(torch.from_numpy(pixels.picture[used])).float(),
        averages=TransportMatrix(matrix=averages.float(), grid=grid),
        clipped=bounds,
        contrast=contrast,
    )


def _person(
    fit: FaceFit, camera: Camera, codes: ndarray, hair: Float[ndarray, "p q"]
) -> tuple[Bool[ndarray, "p q"], Bool[ndarray, "p q"]]:
    """(the person with a margin and all that stands below, the face)."""
    model = HeadModel.load()
    face = _silhouette(
        fit.vertices, model.faces[(model.regions == Region.FACE)[model.faces].all(1)], camera
    )
    rows = np.flatnonzero(face.any(1))
    height = float(len(rows)) if len(rows) else 1.0
    head = _silhouette(fit.vertices, model.faces, camera)
    matte = person_matte(
        codes, head, _silhouette(*bust(fit), camera), hair.astype(np.float32), height
    )
    radius = max(2, round(MARGIN * height))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2)
    person = cv2.dilate(((matte > LEAST_MATTE) | head).astype(np.uint8), disc) > 0
    return np.logical_or.accumulate(person, 0), face


def _silhouette(
    vertices: Float[ndarray, "n 3"], faces: Int[ndarray, "f 3"], camera: Camera
) -> Bool[ndarray, "p q"]:
    """Where the triangles in front of the camera are seen.

    Most of a head's are as small as a pixel: those show what their corners do.
    """
    shown = faces[(vertices[faces][..., 2] < -0.01).all(1)]
    drawn = np.zeros((camera.height, camera.width), np.uint8)
    used, index = np.unique(shown, return_inverse=True)
    if len(used):
        places = camera.project(torch.from_numpy(vertices[used])).numpy() - 0.5
        corners = np.clip(places, -1e4, 1e4).round().astype(np.int32)[index.reshape(-1, 3)]
        column, row = corners.reshape(-1, 2).T
        inside = (row >= 0) & (row < camera.height) & (column >= 0) & (column < camera.width)
        drawn[row[inside], column[inside]] = 1
        for triangle in corners[(np.ptp(corners, 1) > 1).any(1)]:
            cv2.fillConvexPoly(drawn, triangle, 1)
    return drawn > 0


def _even(picture: Shaped[ndarray, "h w 3"]) -> Bool[ndarray, "p q"]:
    """Which small pixels are of such as are exactly the one on their right and the one below."""
    right = (picture[:, :-1] == picture[:, 1:]).all(2)
    below = (picture[:-1] == picture[1:]).all(2)
    even = np.pad(right, ((0, 0), (0, 1)), "edge") & np.pad(below, ((0, 1), (0, 0)), "edge")
    return _small(even.astype(np.float32)) > FLAT_SHARE


def drawn_parts(
    encoded: UInt8[ndarray, "h w 3"], person: Float[ndarray, "h w"]
) -> Float[ndarray, "h w"]:
    """1 where a picture is a frame, a bar, or what is about a round crop or a cut-out person."""
    people = _small(person.astype(np.float32)) > LEAST_MATTE
    drawn = _drawn(_small(encoded), _even(encoded), people)
    return cv2.resize(drawn.astype(np.float32), person.shape[::-1], interpolation=cv2.INTER_LINEAR)


def _small(image: Shaped[ndarray, "h w *c"]) -> Shaped[ndarray, "p q *c"]:
    """In pixels of which the longer side has :data:`LONG_SIDE_PX`, or as it is."""
    height, width = image.shape[:2]
    scale = min(1.0, LONG_SIDE_PX / max(height, width))
    size = max(2, round(width * scale)), max(2, round(height * scale))
    return cv2.resize(np.ascontiguousarray(image), size, interpolation=cv2.INTER_AREA)


def _drawn(
    codes: ndarray, even: Bool[ndarray, "p q"], people: Bool[ndarray, "p q"]
) -> Bool[ndarray, "p q"]:
    """Frames, bars and what is about a round crop or a cut-out.

    What is alike in all corners that show no person is; a white sky has other ones below it, and
    white light fades. Bars fill whole rows or columns at a side, and are not white.
    """
    drawn = np.zeros(even.shape, bool)
    corners = [(r, c) for r in (1, -2) for c in (1, -2) if not people[r, c]]
    values = codes.astype(int)
    if len(corners) > 1 and all(even[place] for place in corners):
        colour = values[corners[0]]
        if all(np.abs(values[place] - colour).max() < SAME_CODES for place in corners):
            alike = even & (np.abs(values - colour).max(2) < SAME_CODES)
            _, label = cv2.connectedComponents(alike.astype(np.uint8))
            alike = np.isin(label, [label[place] for place in corners])
            if not _fades(values, alike, people):
                drawn = alike
    for turns in range(4):
        side, lines = np.rot90(even | drawn, turns), np.rot90(values, turns)
        bar = side.all(1) & (np.ptp(lines, 1).max(1) < SAME_CODES) & (lines[:, 0].min(1) < 255)
        depth = int(np.argmin(np.append(bar, False)))
        np.rot90(drawn, turns)[:depth] = True
    grown = cv2.dilate(drawn.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    return grown


def _fades(codes: ndarray, part: Bool[ndarray, "p q"], people: Bool[ndarray, "p q"]) -> bool:
    """Whether it is white that other light runs over into, as about a lamp or a window."""
    near, far = (cv2.dilate(part.astype(np.uint8), np.ones((n, n), np.uint8)) > 0 for n in (3, 7))
    ring = far & ~near & ~people
    white = codes[part].min() == 255
    return bool(white and ring.any() and np.median(codes[ring].min(1)) > 255 - SOFT_CODES)


def _beyond_seams(codes: ndarray, faces: Bool[ndarray, "p q"]) -> Bool[ndarray, "p q"]:
    """What straight steps, as long as the picture, part from the faces: other photographs."""
    beyond = np.zeros(faces.shape, bool)
    for turned in (False, True):
        image, face = (np.swapaxes(each, 0, 1) if turned else each for each in (codes, faces))
        here = np.flatnonzero(face.any(0))
        if len(here) == 0:
            continue
        # two pixels apart: shrinking spreads a step over two
        step = np.abs(np.diff(image.astype(int), axis=1)).max(2)
        step = np.maximum(step[:, :-1], step[:, 1:])
        seams = np.flatnonzero((step > SEAM_CODES).mean(0) > SEAM_SHARE) + 1
        left, right = seams[seams < here[0]], seams[seams > here[-1]]
        lines = beyond.T if turned else beyond
        if len(left):
            lines[:, : left[-1] + 2] = True
        if len(right):
            lines[:, right[0] - 1 :] = True
    return beyond
