"""Which shots of a turning camera show the same, and where: shots, lens, features and matches.

A shot is a merged exposure at a working size, and what features see of it. SIFT's features (Lowe
2004, "Distinctive image features from scale-invariant keypoints") by the Hellinger kernel
(Arandjelovic & Zisserman 2012) are matched as mutual nearest neighbours by Lowe's ratio, and a
rotation between two shots is found by RANSAC
(:func:`skylight.imaging._camera_turns.turn_between`). In a clear sky there is nothing to match but
the sun: :func:`lamp_links`.

The lens is one focal length and one radial distortion about the middle of the picture. Places
(x, y) in a picture count from its upper left corner, pixel centres at halves; the camera looks
along -Z, +X is the picture's right, +Y its up (:mod:`skylight.probes.cameras._intrinsics` has the
other way to say so).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from skylight.imaging._camera_turns import Link, pinhole_rays, turn_between
from skylight.probes.cameras._exposures import Merged
from skylight.probes.cameras._intrinsics import FLIP, Intrinsics
from skylight.sphere._envmap import LUMINANCE
from skylight.work._progress import Progress

WORKING_SIDE = 1000  # px of the longer side: maps of up to 1024 rows show no more of a usual lens
_DARK_SHARE = 0.02  # quantiles of log luminance that become black and white for features
_FLOOR = 1e-6  # of the brightest: what is darker counts as that dark
_MOST_FEATURES = 1000  # of a shot
_CONTRAST = 0.02  # below SIFT's usual 0.04: clouds are faint
_RATIO = 0.8
_FEWEST = 10  # matches of two shots
# A lamp: so many times the median's light, at half its own brightness so small a part of a shot.
_LAMP_OVER_MEDIAN, _LAMP_SHARE = 30.0, 0.01
_SAME_LAMP = 4.0  # factor between what two shots may show of it
_SEARCHED = 40  # links, those of most matches, by which the focal length is searched for


@dataclass(frozen=True, kw_only=True)
class Lens:
    """Pictures of ``width`` x ``height``, ``focal_px`` in their pixels; Brown's ``k1``."""

    width: int
    height: int
    focal_px: float
    k1: float = 0.0

    @property
    def size(self) -> tuple[int, int]:
        return self.width, self.height

    @cached_property
    def intrinsics(self) -> Intrinsics:
        """The same in OpenCV's convention, pixel centres at integers."""
        return Intrinsics(
            width=self.width,
            height=self.height,
            fx=self.focal_px,
            fy=self.focal_px,
            cx=(self.width - 1) / 2,
            cy=(self.height - 1) / 2,
            k1=self.k1,
        )

    @property
    def half_diagonal_rad(self) -> float:
        """From the middle of the picture to its corners."""
        (corner,) = self.rays(np.zeros((1, 2)))
        return float(np.arccos(-corner[2]))

    def rays(self, places: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
        """Unit directions in the camera's frame."""
        straight = self.intrinsics.undistort_points(places - 0.5) + 0.5
        return pinhole_rays(straight, self.focal_px, self.size)

    def project(self, rays: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Where directions in the camera's frame are seen; nonsense for those not :meth:`ahead`."""
        return self.intrinsics.project(rays @ FLIP) + 0.5

    def ahead(self, rays: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Which directions lie before the camera, where distortion does not fold the picture.

        r (1 + k1 r^2) grows up to r^2 = -1 / (3 k1).
        """
        depth = -rays[:, 2]
        r2 = (rays[:, :2] ** 2).sum(1) / np.maximum(depth, 1e-6) ** 2
        return (depth > 0.05) & (1 + 3 * self.k1 * r2 > 0)

    def scaled(self, width: int, height: int) -> "Lens":
        """The same lens for pictures of another size."""
        return replace(
            self, width=width, height=height, focal_px=self.focal_px * width / self.width
        )


@dataclass(frozen=True, kw_only=True)
class Shot:
    """What the camera saw in one direction, scaled down to :data:`WORKING_SIDE` at most.

    ``radiance`` is linear light in one unit for all shots, ``clipped`` the share of each pixel
    that saturates even the shortest exposure, and ``width`` that of the picture as it was taken.
    """

    name: str
    radiance: Float[np.ndarray, "h w 3"]
    clipped: Float[np.ndarray, "h w"]
    width: int

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of ``radiance``."""
        return self.radiance.shape[1], self.radiance.shape[0]

    @property
    def light(self) -> Float[np.ndarray, "h w"]:
        """Luminance."""
        return self.radiance @ np.array(LUMINANCE, np.float32)

    @property
    def scale(self) -> float:
        """Pixels of ``radiance`` per pixel of the picture."""
        return self.radiance.shape[1] / self.width


def shot_of(name: str, merged: Merged, gain: float = 1.0) -> Shot:
    """A shot of merged exposures, times ``gain``, scaled down by areas: light is kept."""
    radiance, clipped = merged.radiance.numpy(), merged.clipped.numpy().astype(np.float32)
    height, width = clipped.shape
    scale = min(1.0, WORKING_SIDE / max(width, height))
    size = max(1, round(scale * width)), max(1, round(scale * height))
    return Shot(
        name=name,
        radiance=gain * cv2.resize(radiance, size, interpolation=cv2.INTER_AREA),
        clipped=cv2.resize(clipped, size, interpolation=cv2.INTER_AREA),
        width=width,
    )


def for_features(shot: Shot) -> UInt8[np.ndarray, "h w"]:
    """Log luminance as 8-bit grey: edges in shadows count as much as those in the light."""
    light = shot.light
    logs = np.log(np.maximum(light, _FLOOR * light.max() + 1e-30))
    dark, bright = np.quantile(logs, (_DARK_SHARE, 1 - _DARK_SHARE))
    return np.clip(np.rint(255 * (logs - dark) / max(bright - dark, 1e-3)), 0, 255).astype(np.uint8)


@dataclass(frozen=True, kw_only=True)
class Features:
    """Places (n,2) of a shot's features and their descriptors, of length 1."""

    places: Float[np.ndarray, "n 2"]
    descriptors: Float[np.ndarray, "n 128"]


@dataclass(frozen=True, kw_only=True)
class RotatedLink:
    """A link whose matches agree on a turn from the later shot's frame to the earlier one's."""

    link: Link
    rotation: Float[np.ndarray, "3 3"]


def find_features(shot: Shot) -> Features:
    """SIFT's of the shot's log luminance, where nothing is saturated."""
    detector = cv2.SIFT.create(_MOST_FEATURES, contrastThreshold=_CONTRAST)
    clear = (shot.clipped == 0).astype(np.uint8)
    points, values = detector.detectAndCompute(for_features(shot), clear)
    if not points:
        return Features(places=np.zeros((0, 2)), descriptors=np.zeros((0, 128), np.float32))
    # OpenCV's places have pixel centres at integers
    places = np.array([point.pt for point in points], dtype=np.float64) + 0.5
    share = values / np.maximum(values.sum(1, keepdims=True), 1e-6)
    return Features(places=places, descriptors=np.sqrt(share))


def link_shots(
    features: Sequence[Features],
    may_overlap: Callable[[int, int], bool],
    progress: Progress = lambda share: None,
) -> list[Link]:
    """Matches of all pairs of shots that may overlap, where there are ten or more."""
    links = []
    for start, one in enumerate(features):
        progress(start / len(features))
        for end in range(start + 1, len(features)):
            if may_overlap(start, end):
                here, there = _matched(one, features[end])
                if len(here) >= _FEWEST:
                    before, after = one.places[here], features[end].places[there]
                    links.append(Link(start=start, end=end, before=before, after=after))
    return links


def lamp_links(shots: Sequence[Shot]) -> list[Link]:
    """The sun, or another small lamp far brighter than all else, in any two shots that show it.

    One match each. Two shots may show different lamps: by then rotations must tell which do not.
    """
    lamps = {number: lamp for number, shot in enumerate(shots) if (lamp := _lamp(shot))}
    return [
        Link(start=one, end=two, before=first[None], after=second[None])
        for one, (first, light) in lamps.items()
        for two, (second, other) in lamps.items()
        if one < two and max(light, other) < _SAME_LAMP * min(light, other)
    ]


def _lamp(shot: Shot) -> tuple[Float[np.ndarray, "2"], float] | None:
    """(place, sum of light) of a shot's lamp, where it has one."""
    light = shot.light
    peak = float(light.max())
    if peak <= _LAMP_OVER_MEDIAN * float(np.median(light)):
        return None
    _, labels = cv2.connectedComponents((light > peak / 2).astype(np.uint8))
    lamp = labels == labels.flat[int(light.argmax())]
    rows, columns = np.nonzero(lamp)
    height, width = light.shape
    at_edge = min(rows.min(), columns.min()) == 0 or (
        rows.max() == height - 1 or columns.max() == width - 1
    )
    if at_edge or lamp.mean() > _LAMP_SHARE:
        return None
    weight = light[lamp].astype(np.float64)
    place = np.array([weight @ columns, weight @ rows]) / weight.sum() + 0.5
    return place, float(weight.sum())


def strongest_links(links: Sequence[Link]) -> list[Link]:
    """The links of most matches, enough to search for a focal length by."""
    return sorted(links, key=lambda link: -len(link.before))[:_SEARCHED]


def rotated_links(links: Sequence[Link], lens: Lens) -> list[RotatedLink]:
    """Those whose matches agree on a turn."""
    found = []
    for link in links:
        rotation = turn_between(link, lens.focal_px, lens.size)
        if rotation is not None:
            found.append(RotatedLink(link=link, rotation=rotation))
    return found


def _matched(one: Features, two: Features) -> tuple[np.ndarray, np.ndarray]:
    """Indices of features that are each other's nearest, clearly nearer than the second."""
    nothing = np.zeros(0, int)
    if min(len(one.places), len(two.places)) < 2:
        return nothing, nothing
    alike = one.descriptors @ two.descriptors.T
    best = np.argpartition(alike, -2, axis=1)[:, -2:]
    values = np.take_along_axis(alike, best, 1)
    order = values.argsort(1)
    there = np.take_along_axis(best, order[:, 1:], 1)[:, 0]
    second, first = np.take_along_axis(values, order, 1).T
    # squared distances of unit vectors are 2 - 2 cosines
    clear = (1 - first) < _RATIO**2 * (1 - second)
    mutual = alike.argmax(0)[there] == np.arange(len(there))
    here = np.flatnonzero(clear & mutual)
    return here, there[here]
