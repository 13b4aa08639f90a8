"""The faces under one sky, as its solver needs them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import fmean
from typing import NamedTuple

import torch

from skylight.inverse.objective.face_term import FaceTerm
from skylight.inverse.scan import SCAN_HEIGHT
from skylight.inverse.sun_prior import SunPrior
from skylight.transport.observation import Observation


class Level(NamedTuple):
    """Of the pyramid: 1 / 2^``pixels`` of the picture's resolution, 1 / 2^``light`` of the sky's.

    A sky on half as many rows takes a quarter of the time.
    """

    pixels: int
    light: int = 0


@dataclass(frozen=True, kw_only=True)
class ScannedFace:
    """What a solver needs of an observation: the pyramid's levels, and what the scan reads.

    Both are scaled to a mean luminance of 1 from ``mean``, in the photograph's units.
    """

    photo: int
    pyramid: dict[Level, FaceTerm]
    scanned: Observation
    mean: float

    @staticmethod
    def of(
        observation: Observation,
        photo: int,
        levels: Sequence[Level],
        device: torch.device,
        *,
        sphere: bool = False,
    ) -> "ScannedFace":
        """With those ``levels`` of the pyramid, on that device; for skies or the whole sphere.

        Raises
        ------
        InputError
            The face is black.
        """
        mean = observation.mean_luminance
        pyramid = [observation.to(device).scaled(1 / mean)]
        while len(pyramid) <= max(level.pixels for level in levels):
            pyramid.append(pyramid[-1].coarser(1))
        assert observation.transport.grid.layout is not None
        rows = observation.transport.grid.layout[0]

        def term(level: Level) -> FaceTerm:
            coarse = pyramid[level.pixels].on_rows(rows >> level.light)
            return FaceTerm.of(coarse, sphere=sphere)

        return ScannedFace(
            photo=photo,
            pyramid={level: term(level) for level in levels},
            scanned=pyramid[0].on_rows(SCAN_HEIGHT),
            mean=mean,
        )


class LitFaces(list[ScannedFace]):
    """The faces under one sky, in the order in which they were added.

    ``sun_prior`` is what clock and place tell of their sun, or None.
    """

    def __init__(self, sun_prior: SunPrior | None = None) -> None:
        super().__init__()
        self.sun_prior = sun_prior

    @property
    def shape(self) -> tuple[tuple[int, bool, bool, bool, bool], ...]:
        """What problems have in common that can be solved together."""
        return tuple(
            (
                one.photo,
                one.scanned.gloss is None,
                one.scanned.modes is None,
                one.scanned.normal_modes is None,
                one.scanned.grey,
            )
            for one in self
        )

    def scales(self) -> list[float]:
        """The mean luminance of each photograph's faces."""
        count = 1 + max(face.photo for face in self)
        return [fmean(face.mean for face in self if face.photo == k) for k in range(count)]

    def terms(self, level: Level) -> list[FaceTerm]:
        """Of one problem: each face at a level of the pyramid, in units of its photograph's scale.

        So are the exposures that explain it.
        """
        scales, terms = self.scales(), []
        for face in self:
            term, relative = face.pyramid[level], face.mean / scales[face.photo]
            terms.append(
                replace(
                    term,
                    target=term.target * relative,
                    photo=face.photo,
                    level=term.level * relative,
                )
            )
        return terms
