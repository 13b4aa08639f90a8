"""An estimate from photographs with the faces that it was made from."""

from dataclasses import dataclass, field, replace

from skylight.faces.fit import FaceFit
from skylight.faces.landmarks import DetectedFace
from skylight.faces.observe import FaceView
from skylight.imaging.photo import Photo
from skylight.imaging.taken import Taken
from skylight.inverse.result import Estimate
from skylight.inverse.scan import SCAN_HEIGHT

# Of transport once the solver has taken what it needs: as many as lamps are found on, so that the
# faces can be seen under other ones.
KEPT_ROWS = SCAN_HEIGHT


@dataclass(frozen=True, kw_only=True)
class SeenFace:
    """Face ``number`` (1 is the largest) of photograph ``photo``, counted from 0, named ``name``.

    Harmonics have coarser transport than skies, without gloss: a sky cannot be fitted to it.
    Where several heads were fitted, ``view.observation`` keeps its transport on
    :data:`KEPT_ROWS` rows only.
    """

    photo: int
    number: int
    name: str
    face: DetectedFace
    fit: FaceFit
    view: FaceView

    def on_fewer_rows(self) -> "SeenFace":
        """With transport on :data:`KEPT_ROWS` rows, a quarter of the memory of a sky's."""
        observation = self.view.observation.on_rows(KEPT_ROWS)
        return replace(self, view=replace(self.view, observation=observation))


@dataclass(frozen=True, kw_only=True)
class PhotoEstimate:
    """The estimate with everything on the way to it; ``seconds`` per stage.

    ``photos`` and their ``names`` are all that were given; ``seen`` holds the faces of
    ``estimate.faces``, in their order; ``face``, ``fit`` and ``view`` are the first one's.
    ``taken`` is what was known of time, place and heading, which results do not repeat.
    """

    estimate: Estimate
    photos: tuple[Photo, ...]
    names: tuple[str, ...]
    seen: tuple[SeenFace, ...]
    taken: Taken
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def face(self) -> DetectedFace:
        return self.seen[0].face

    @property
    def fit(self) -> FaceFit:
        return self.seen[0].fit

    @property
    def view(self) -> FaceView:
        return self.seen[0].view
