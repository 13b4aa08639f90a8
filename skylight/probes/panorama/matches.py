"""Which shots show the same, and where: features, their matches, and the turns that agree.

SIFT's features (Lowe 2004, "Distinctive image features from scale-invariant keypoints") by the
Hellinger kernel (Arandjelovic & Zisserman 2012), mutual nearest neighbours by Lowe's ratio, and a
rotation between two shots by RANSAC (:func:`skylight.cameras.turns.turn_between`). In a clear sky
there is nothing to match but the sun: :func:`lamp_links`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from skylight.cameras.turns import Link, turn_between
from skylight.probes.panorama.lens import Lens
from skylight.probes.panorama.shots import Shot, for_features
from skylight.work.progress import Progress

_MOST_FEATURES = 1000  # of a shot
_CONTRAST = 0.02  # below SIFT's usual 0.04: clouds are faint
_RATIO = 0.8
_FEWEST = 10  # matches of two shots
# A lamp: so many times the median's light, at half its own brightness so small a part of a shot.
_LAMP_OVER_MEDIAN, _LAMP_SHARE = 30.0, 0.01
_SAME_LAMP = 4.0  # factor between what two shots may show of it
_SEARCHED = 40  # links, those of most matches, by which the focal length is searched for


@dataclass(frozen=True, kw_only=True)
class Features:
    """Places (n,2) of a shot's features and their descriptors, of length 1."""

    places: Float[np.ndarray, "n 2"]
    descriptors: Float[np.ndarray, "n 128"]


@dataclass(frozen=True, kw_only=True)
class Turned:
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


def most_told(links: Sequence[Link]) -> list[Link]:
    """The links of most matches, enough to search for a focal length by."""
    return sorted(links, key=lambda link: -len(link.before))[:_SEARCHED]


def turned_links(links: Sequence[Link], lens: Lens) -> list[Turned]:
    """Those whose matches agree on a turn."""
    found = []
    for link in links:
        rotation = turn_between(link, lens.focal_px, lens.size)
        if rotation is not None:
            found.append(Turned(link=link, rotation=rotation))
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
