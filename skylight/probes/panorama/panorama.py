"""A light probe from the shots of a turning camera: matches, rotations and lens, one map."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from skylight.cameras.turns import focal_from_turns
from skylight.errors import InputError
from skylight.probes.panorama.bundle import Bundle, adjust, spanning_trees
from skylight.probes.panorama.lens import Lens
from skylight.probes.panorama.level import aligned, levelled
from skylight.probes.panorama.matches import (
    Turned,
    find_features,
    lamp_links,
    link_shots,
    most_told,
    turned_links,
)
from skylight.probes.panorama.shots import Shot
from skylight.probes.panorama.stitch import stitch
from skylight.probes.radiance.clipping import Clipping, find_clipping
from skylight.probes.radiance.probe_map import ProbeMap
from skylight.work.progress import StageProgress

# Of the longer side: where nothing tells, a picture is 53 degrees wide, give or take a factor of 3.
_FOCAL_GUESS, _FOCAL_SPREAD = 1.0, 0.37
_FEW_FEATURES = 30
_HINT_MARGIN_RAD = math.radians(10.0)

Turns = Mapping[int, Float[np.ndarray, "3 3"]]


@dataclass(frozen=True, kw_only=True)
class Panorama:
    """The probe and how it came about.

    ``by_hint`` are shots that match no other and were placed by their hints alone; ``left_out``
    those without a hint that no matches link to the largest group of shots, or to a shot with one.
    """

    probe: ProbeMap
    bundle: Bundle
    clipping: Clipping | None
    by_hint: tuple[int, ...]
    left_out: tuple[int, ...]


def panorama_of(
    shots: Sequence[Shot],
    height: int,
    *,
    focal_px: float | None = None,
    hints: Turns | None = None,
    progress: StageProgress = lambda stage, share: None,
) -> Panorama:
    """Stitch shots of one size.

    Parameters
    ----------
    focal_px
        About the focal length in pixels of the shots; found from their turns where None.
    hints
        Rotations (world from camera) of some or all shots, known to two degrees or so. The map is
        then in their world; otherwise it is upright, and its centre is where the first shot looks.

    Raises
    ------
    InputError
        Fewer than two shots, sizes that differ, too few features, no overlap, or hints of which
        none is for the largest group of shots that match.
    """
    hints = dict(hints or {})
    _check(shots)
    width, rows = shots[0].size
    lens = Lens(width=width, height=rows, focal_px=focal_px or _FOCAL_GUESS * max(width, rows))
    features = []
    for number, shot in enumerate(shots):
        progress("finding features", number / len(shots))
        features.append(find_features(shot))

    def may_overlap(one: int, two: int) -> bool:
        if focal_px is None or one not in hints or two not in hints:
            return True
        apart = math.acos(np.clip(hints[one][:, 2] @ hints[two][:, 2], -1, 1))
        return apart < 2 * lens.half_diagonal_rad + _HINT_MARGIN_RAD

    links = link_shots(features, may_overlap, lambda share: progress("matching shots", share))
    progress("finding rotations", 0.0)
    if focal_px is None and links:
        found, _ = focal_from_turns(most_told(links), lens.focal_px, _FOCAL_SPREAD, lens.size)
        lens = replace(lens, focal_px=found)
    turned = turned_links(links, lens)
    if not turned:
        raise InputError(_why_none(shots, [len(each.places) for each in features]))
    bundle = adjust(turned, lamp_links(shots), _start(turned, hints, shots), lens, hints)
    if not hints:
        bundle = replace(bundle, rotations=levelled(bundle.rotations))
    probe = stitch(
        shots, bundle.rotations, bundle.lens, height, lambda share: progress("stitching", share)
    )
    placed = bundle.rotations
    matched = {shot for each in turned for shot in (each.link.start, each.link.end)}
    return Panorama(
        probe=probe,
        bundle=bundle,
        clipping=find_clipping(probe),
        by_hint=tuple(number for number in sorted(placed) if number not in matched),
        left_out=tuple(number for number in range(len(shots)) if number not in placed),
    )


def _start(turned: Sequence[Turned], hints: Turns, shots: Sequence[Shot]) -> Turns:
    """Rotations from matches, in the hints' world where there are any, and the hints.

    Groups of shots that hang together by matches are turned as a whole to meet their hints. A
    smaller group without hints is left out: nothing tells how it is turned against the others.
    """
    largest, *_ = groups = spanning_trees(turned)
    if not hints:
        return largest
    if not largest.keys() & hints.keys():
        raise InputError(
            f"none of the {len(largest)} shots that match each other, the most that do, has a row "
            f"in --turns: give one of them, such as {shots[min(largest)].name}"
        )
    start = dict(hints)
    for group in groups:
        if group.keys() & hints.keys():
            start |= aligned(group, hints)
    return start


def _check(shots: Sequence[Shot]) -> None:
    if len(shots) < 2:
        raise InputError(
            "one direction is no panorama: give shots of two or more that overlap, each in a "
            "folder of its own, or all in a row with the same exposures"
        )
    for shot in shots:
        if (shot.size, shot.width) != (shots[0].size, shots[0].width):
            raise InputError(
                f"{shot.name} has other measures than {shots[0].name}: take all shots with one "
                "lens, in one size, and hold the camera one way"
            )


def _why_none(shots: Sequence[Shot], counts: Sequence[int]) -> str:
    mend = "let neighbours overlap by a third, or say where they look with --turns"
    if np.median(counts) < _FEW_FEATURES:
        return (
            f"the shots show too few details to be matched ({int(np.median(counts))} in the "
            f"median, {min(counts)} to {max(counts)}): see that they are sharp, {mend}"
        )
    return f"no two of {len(shots)} shots overlap: {mend}"
