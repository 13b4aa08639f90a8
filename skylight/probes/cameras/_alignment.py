"""The pose of an object, refined on the outlines of its bright faces in all pictures jointly.

A round pole leaves the rotation about its axis undetermined, and sockets have play. Small faces
constrain the pose too weakly in any one picture; one rigid motion shared by all pictures is well
constrained.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from skylight.probes.cameras._edges import (
    across_edges,
    blurred_grey,
    strongest_steps,
    tukey_weights,
)
from skylight.probes.cameras._intrinsics import FLIP, Intrinsics
from skylight.probes.cameras._pose import camera_centre, in_frame
from skylight.sphere._rotation import RigidTransform

Sees = Callable[[Float[np.ndarray, "3"], Float[np.ndarray, "*n 3"]], Float[Tensor, "*n"]]
"""(eye, points) -> 1 where nothing is between them."""

_T = TypeVar("_T")

_GRAZING = 0.2  # cosine: of faces turned away further, both sides of an edge fall together
_LIFTED_MM = 0.02  # off the face, before looking whether it is hidden
_TRIED = 14  # places from an edge onto the face, of which the first that is seen bounds it
_SEARCH_PX, _SEARCH_LAST_PX = 8.0, 2.5
_NARROWER = 0.75
_AGREE_PX = 1.5
_ROUNDS, _STILL = 20, 1e-3  # degrees and mm
_LEAN_DEG, _SHIFT_MM = 2.0, 3.0  # play of sockets, one sigma; the turn about the pole is free
_VIEWS_MOST, _PLACES_MOST = 8, 600  # for the search
_STEP_DEG, _STARTS = 5.0, 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Outline:
    """Places where a bright face meets what is dark, in the board's frame, mm.

    The edge goes ``along`` (p,3), the face ``into`` (p,3) from there, and looks ``outward`` (p,3).
    What stands above it may hide the face from there to ``covered_mm`` into it.
    """

    places: Float[np.ndarray, "p 3"]
    along: Float[np.ndarray, "p 3"]
    into: Float[np.ndarray, "p 3"]
    outward: Float[np.ndarray, "p 3"]
    covered_mm: float

    def only(self, chosen: Bool[np.ndarray, " p"] | Int[np.ndarray, " k"]) -> "Outline":
        """Some of it."""
        return Outline(
            places=self.places[chosen],
            along=self.along[chosen],
            into=self.into[chosen],
            outward=self.outward[chosen],
            covered_mm=self.covered_mm,
        )


@dataclass(frozen=True, kw_only=True)
class OutlineFit:
    """An object's motion, its standard error, and how much of the outline agrees with it.

    ``motion``, in mm, has its origin in the object's centre as assembled: in the board's frame it
    is ``motion.about(centre)``. In each picture ``places`` counts the points of the outline that
    should be seen, ``agree`` those with an edge within 1.5 px. ``turn_error_deg`` is the standard
    error of the rotation about the vertical.
    """

    motion: RigidTransform
    turn_error_deg: float
    agree: Int[np.ndarray, " v"]
    places: Int[np.ndarray, " v"]

    @property
    def turn_deg(self) -> Float[np.ndarray, "3"]:
        """Rotation vector of the motion."""
        return np.degrees(self.motion.rotation_vector.numpy())

    @property
    def shift_mm(self) -> Float[np.ndarray, "3"]:
        """Of the object's centre."""
        return self.motion.translation.numpy()

    @property
    def share(self) -> float:
        """Of the outline that is where the motion says."""
        return float(self.agree.sum() / max(self.places.sum(), 1))


class OutlineAligner:
    """Gathers pictures; ``sees`` tells what the object hides of itself where it was meant to be."""

    def __init__(
        self,
        outline: Outline,
        sees: Sees,
        centre_mm: Float[Tensor, "3"],
        intrinsics: Intrinsics,
    ) -> None:
        self._outline, self._sees = outline, sees
        self._centre, self._intrinsics = centre_mm, intrinsics
        self._views: list[_View] = []

    def add(self, image: UInt8[np.ndarray, "h w 3"], board: RigidTransform) -> None:
        """Take a picture and the board's pose in it."""
        self._intrinsics.require_size(image.shape[1], image.shape[0])
        self._views.append(_View(blurred_grey(image), board))

    def unmoved(self) -> OutlineFit:
        """How much of the outline is where it was meant to be."""
        return self._fit_of(RigidTransform.identity(), np.inf)

    def best(self, range_deg: float) -> list[OutlineFit]:
        """Fits started from rotations about the vertical within +- ``range_deg``, the best first.

        Tried every 5 degrees on some of the outline in some pictures; the best four and no turn
        are followed on all of it.
        """
        views = _some(self._views, _VIEWS_MOST)
        count = len(self._outline.places)
        outline = self._outline.only(np.array(_some(range(count), _PLACES_MOST), dtype=np.int64))
        steps = int(range_deg // _STEP_DEG)
        turns = _STEP_DEG * np.arange(-steps, steps + 1)

        def score(turn: float) -> float:
            agree = total = 0
            for view in views:
                look = self._look(view, _about_vertical(turn), outline)
                miss = look.misses(_STEP_DEG)
                agree += int((np.abs(miss) < 2 * _AGREE_PX).sum())
                total += len(miss)
            return agree / max(total, 1)

        scores = np.array([score(float(turn)) for turn in turns])
        starts = [0.0]
        for turn in turns[np.argsort(-scores, kind="stable")].tolist():
            if len(starts) <= _STARTS and all(abs(turn - s) > 1.5 * _STEP_DEG for s in starts):
                starts.append(turn)
        fits = [self._followed(_about_vertical(turn)) for turn in starts]
        return sorted((fit for fit in fits if fit is not None), key=lambda fit: -fit.share)

    def _followed(self, motion: RigidTransform) -> OutlineFit | None:
        """From a motion to the nearest that all pictures tell; None where they do not.

        Minimises sum rho((n . d pixel / d motion) m - r) over all places of all pictures, rho
        Tukey's, r how far along n the brightness rises most, with the sockets' play as a prior.
        """
        search = _SEARCH_PX
        prior = np.diag(
            [np.radians(_LEAN_DEG) ** -2, 0, np.radians(_LEAN_DEG) ** -2, *[_SHIFT_MM**-2] * 3]
        )
        for _ in range(_ROUNDS):
            looks = [self._look(view, motion, self._outline) for view in self._views]
            miss = np.concatenate([look.misses(search) for look in looks])
            found = np.isfinite(miss)
            if found.sum() < 12:
                return None
            slope = np.concatenate([look.slopes for look in looks])[found]
            weight, scale = tukey_weights(miss[found])
            information = slope.T @ (weight[:, None] * slope) / scale**2 + prior
            pull = slope.T @ (weight * miss[found]) / scale**2 - prior @ motion.vector().numpy()
            if np.linalg.cond(information) > 1e12:
                return None
            step = np.linalg.solve(information, pull)
            further = RigidTransform.from_vector(torch.from_numpy(step))
            motion = further.about(motion.translation) @ motion
            still = np.abs([*np.degrees(step[:3]), *step[3:]]).max() < _STILL
            if still and search <= _SEARCH_LAST_PX:
                break
            search = max(_SEARCH_LAST_PX, _NARROWER * search)
        variance = np.linalg.inv(information)[1, 1]
        return self._fit_of(motion, float(np.degrees(np.sqrt(variance))))

    def _fit_of(self, motion: RigidTransform, turn_error_deg: float) -> OutlineFit:
        agree, places = [], []
        for view in self._views:
            miss = self._look(view, motion, self._outline).misses(_SEARCH_LAST_PX)
            agree.append(int((np.abs(miss) < _AGREE_PX).sum()))
            places.append(len(miss))
        return OutlineFit(
            motion=motion,
            turn_error_deg=turn_error_deg,
            agree=np.array(agree, dtype=np.int64),
            places=np.array(places, dtype=np.int64),
        )

    def _look(self, view: "_View", motion: RigidTransform, outline: Outline) -> "_Look":
        """What of the outline a picture should show, had the object moved so."""
        pose = view.board @ motion.about(self._centre)
        eye = camera_centre(pose)
        towards = eye - outline.places
        cosine = (towards * outline.outward).sum(1) / np.linalg.norm(towards, axis=1)
        _, inside = in_frame(outline.places[:, None], pose, self._intrinsics)
        seen = np.flatnonzero((cosine > _GRAZING) & inside)
        onto = np.linspace(0, outline.covered_mm, _TRIED)
        first = np.zeros(0, np.int64)
        if len(seen):
            shown = outline.only(seen)
            tried = shown.places[:, None] + onto[:, None] * shown.into[:, None]
            free = self._sees(eye, tried + _LIFTED_MM * shown.outward[:, None]).numpy()
            # where nothing hides the face any more, if that is near the edge
            first = _TRIED - np.cumprod(free[:, ::-1], 1).sum(1).astype(np.int64)
            seen, first = seen[first < _TRIED], first[first < _TRIED]
        if not len(seen):
            return _Look(view.grey, np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 6)))
        shown = outline.only(seen)
        places = pose.points(shown.places + onto[first, None] * shown.into) @ FLIP
        turn = FLIP @ pose.rotation.numpy()
        pixels, normal, slopes = across_edges(places, shown.along @ turn.T, self._intrinsics)
        turning, shifting = slopes[..., :3], slopes[..., 3:]
        inward = np.einsum("sij,sj->si", shifting, shown.into @ turn.T)
        normal = normal * np.where((normal * inward).sum(1) < 0, -1.0, 1.0)[:, None]
        # turning about the object's middle c, not about the camera: w x (x - c) = w x x + c x w
        axes = FLIP @ view.board.rotation.numpy()
        middle = FLIP @ view.board.points(self._centre + motion.translation).numpy()
        moves = np.concatenate([(turning + shifting @ _cross(middle)) @ axes, shifting @ axes], 2)
        return _Look(view.grey, pixels, normal, np.einsum("si,sij->sj", normal, moves))


@dataclass(frozen=True)
class _View:
    grey: Float[np.ndarray, "h w"]
    board: RigidTransform


@dataclass(frozen=True)
class _Look:
    """Places of the outline in a picture, towards the face there, and how they follow a motion."""

    grey: Float[np.ndarray, "h w"]
    pixels: Float[np.ndarray, "s 2"]
    normals: Float[np.ndarray, "s 2"]
    slopes: Float[np.ndarray, "s 6"]

    def misses(self, search_px: float) -> Float[np.ndarray, " s"]:
        """How far the brightness rises from the places, px; NaN where it does not."""
        return strongest_steps(self.grey, self.pixels, self.normals, search_px, rising=True)


def _about_vertical(turn_deg: float) -> RigidTransform:
    turn = torch.tensor([0.0, np.radians(turn_deg), 0.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    return RigidTransform.from_vector(turn)


def _cross(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """``_cross(a) @ b`` is a x b."""
    return np.cross(np.eye(3), vector)


def _some(things: Sequence[_T], most: int) -> list[_T]:
    """At most so many, evenly."""
    if len(things) <= most:
        return list(things)
    return [things[i] for i in np.linspace(0, len(things) - 1, most).round().astype(int).tolist()]
