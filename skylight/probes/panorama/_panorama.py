"""A light probe from the shots of a turning camera: matches, rotations and lens, one lat-long map.

The map's world is upright, with the first shot ahead, or as hints say.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import KDTree

from skylight.errors import InputError
from skylight.imaging._camera_turns import best_rotation, focal_from_turns
from skylight.probes._probe_map import ProbeMap, averaged, finer_rows, latlong_directions
from skylight.probes.cameras._exposures import Clipping, find_clipping
from skylight.probes.panorama._bundle import Bundle, adjust, spanning_trees
from skylight.probes.panorama._matches import (
    Lens,
    RotatedLink,
    Shot,
    find_features,
    lamp_links,
    link_shots,
    rotated_links,
    strongest_links,
)
from skylight.sphere._envmap import EnvironmentMap
from skylight.work._progress import Progress, StageProgress

# Of the shots' number: least spread of their right-hand sides that tells the vertical
_SPREAD_MIN = 0.02
_STEEP = 0.9  # sine of the elevation above which a shot tells no azimuth
_MARGIN_PX = 1.0
_POWER = 3  # of the weight that falls from a shot's middle to its edges
# Weight of what is saturated in all exposures: it counts, as a bound, where nothing else is seen.
_SATURATED = 1e-4
# Of the longer side: where nothing tells, a picture is 53 degrees wide, give or take a factor of 3.
_FOCAL_GUESS, _FOCAL_SPREAD = 1.0, 0.37
_FEW_FEATURES = 30
_HINT_MARGIN_RAD = math.radians(10.0)
Turns = Mapping[int, Float[np.ndarray, "3 3"]]


def levelled(
    rotations: dict[int, Float[np.ndarray, "3 3"]],
) -> dict[int, Float[np.ndarray, "3 3"]]:
    """The same rotations, turned together: +Y up, -Z where the first shot looks, or near that.

    Nobody rolls the camera much, so all shots' right-hand sides lie in the horizontal plane: its
    normal is the direction in which they vary least (Brown & Lowe 2007, section 5). Shots that do
    not turn far enough to the side tell no vertical: then it is the first one's own.
    """
    shots = sorted(rotations)
    frames = np.array([rotations[shot] for shot in shots])
    right, up = frames[:, :, 0], frames[:, :, 1]
    spread, axes = np.linalg.eigh(right.T @ right)
    vertical = axes[:, 0] if spread[1] > _SPREAD_MIN * len(shots) else up[0]
    vertical = vertical * (1.0 if up.sum(0) @ vertical > 0 else -1.0)
    ahead = -frames[:, :, 2]
    level = np.flatnonzero(np.abs(ahead @ vertical) < _STEEP)
    # a shot at the zenith has ahead what it has below the picture's lower edge
    towards = ahead[level[0]] if len(level) else -np.sign(ahead[0] @ vertical) * up[0]
    back = -(towards - (towards @ vertical) * vertical)
    back /= np.linalg.norm(back)
    upright = np.stack([np.cross(vertical, back), vertical, back])
    return {shot: upright @ rotations[shot] for shot in shots}


def aligned(
    rotations: Mapping[int, Float[np.ndarray, "3 3"]],
    hints: Mapping[int, Float[np.ndarray, "3 3"]],
) -> dict[int, Float[np.ndarray, "3 3"]]:
    """The same rotations, turned together to meet the hints best, in the least-squares sense."""
    both = [shot for shot in rotations if shot in hints]
    turn = best_rotation(np.sum([hints[shot] @ rotations[shot].T for shot in both], axis=0))
    return {shot: turn @ rotations[shot] for shot in rotations}


def rotation_to(azimuth_deg: float, elevation_deg: float) -> Float[np.ndarray, "3 3"]:
    """World from camera: turned to the right from -Z, then up, without roll."""
    a, e = np.radians(azimuth_deg), np.radians(elevation_deg)
    yaw = np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
    pitch = np.array([[1, 0, 0], [0, np.cos(e), -np.sin(e)], [0, np.sin(e), np.cos(e)]])
    return yaw @ pitch


def stitch(
    shots: Sequence[Shot],
    rotations: Mapping[int, Float[np.ndarray, "3 3"]],
    lens: Lens,
    height: int,
    progress: Progress = lambda share: None,
) -> ProbeMap:
    """The light round the camera on ``height`` rows, averaged down from a finer map.

    Each direction is the mean of the shots that show it, weighted by how far from a shot's edges
    it is and by how little of it is saturated,
    ``(1 - |2x/w - 1|)^3 (1 - |2y/h - 1|)^3 (1 - clipped)``.
    Vignetting is not undone: the edges of a lens that has much of it come out too dark, by less
    than the lens itself says, since edges count little where shots overlap. What no shot shows
    holds the nearest direction that one does.
    """
    fine = finer_rows(height, lens.focal_px)  # as dense as the middles of shots
    directions = latlong_directions(fine).numpy().reshape(-1, 3)
    # the density of the fine map's rows, so that a look-up between pixels leaves no light out
    scale = min(1.0, fine / math.pi / lens.focal_px)
    size = max(2, round(lens.width * scale)), max(2, round(lens.height * scale))
    small = lens.scaled(*size)
    light = np.zeros((len(directions), 4))
    weights = np.zeros(len(directions))
    limit = math.cos(min(small.half_diagonal_rad + 0.02, math.pi / 2))
    for done, (number, rotation) in enumerate(rotations.items()):
        progress(done / len(rotations))
        near = np.flatnonzero(directions @ -rotation[:, 2] > limit)
        rays = directions[near] @ rotation
        places = small.project(rays)
        inside = small.ahead(rays) & (places > _MARGIN_PX).all(1)
        inside &= (places < np.array(size) - _MARGIN_PX).all(1)
        near, places = near[inside], places[inside]
        seen = _look_up(shots[number], size, places)
        centred = 1 - np.abs(2 * places / np.array(size) - 1)
        weight = centred.prod(1) ** _POWER * (1 - seen[:, 3] + _SATURATED)
        light[near] += weight[:, None] * seen
        weights[near] += weight
    shown = weights > 0
    light[shown] /= weights[shown, None]
    layout = fine, 2 * fine
    return _filled(
        averaged(
            light[:, :3].reshape(*layout, 3),
            light[:, 3].reshape(layout),
            shown.reshape(layout),
            height,
        )
    )


def _look_up(
    shot: Shot, size: tuple[int, int], places: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 4"]:
    """Light and the share that is clipped, bilinear, of a shot scaled to ``size``."""
    values = np.dstack([shot.radiance, shot.clipped]).astype(np.float32)
    small = cv2.resize(values, size, interpolation=cv2.INTER_AREA)
    # remap takes pictures of fewer than 32768 columns and rows: places in blocks of rows
    blocks = np.array_split((places - 0.5).astype(np.float32), max(1, len(places) // 16384))
    found = [cv2.remap(small, b[:, :1], b[:, 1:], cv2.INTER_LINEAR)[:, 0] for b in blocks if len(b)]
    return np.concatenate([np.zeros((0, 4), np.float32), *found])


def _filled(probe: ProbeMap) -> ProbeMap:
    """Light of pixels that were seen in part is the mean of that part, of others the nearest's."""
    environment = probe.environment
    light, seen = environment.flat.numpy().copy(), probe.seen.numpy().ravel()
    clipped = probe.clipped.numpy().ravel().copy()
    shown = seen > 0
    light[shown] /= seen[shown, None]
    clipped[shown] /= seen[shown]
    directions = environment.grid.directions.numpy()
    if not shown.all():
        _, nearest = KDTree(directions[shown]).query(directions[~shown])
        light[~shown] = light[shown][nearest]
    return ProbeMap(
        environment=EnvironmentMap(
            radiance=torch.from_numpy(light).reshape(environment.radiance.shape)
        ),
        clipped=torch.from_numpy(clipped).reshape(probe.seen.shape),
        seen=probe.seen,
    )


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
        found, _ = focal_from_turns(strongest_links(links), lens.focal_px, _FOCAL_SPREAD, lens.size)
        lens = replace(lens, focal_px=found)
    turned = rotated_links(links, lens)
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


def _start(turned: Sequence[RotatedLink], hints: Turns, shots: Sequence[Shot]) -> Turns:
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
