"""What the estimates of a folder depend on besides its photographs."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from skylight.faces.names import HeadName, LandmarkerName, WhichFaces
from skylight.models.known_ground import KnownGround, check_has_ground
from skylight.models.names import (
    DEFAULT_LIGHT,
    DEFAULT_SOLVER,
    LightName,
    SolverName,
    check_is_trained,
    check_light_name,
    check_solver_name,
)

if TYPE_CHECKING:
    from skylight.imaging.colour import Decode


@dataclass(frozen=True, kw_only=True)
class BatchSettings:
    """What every estimate of a batch depends on besides its photo; as in ``skylight.estimate``.

    With ``keep_place`` results tell time, place and heading.
    """

    light: LightName = DEFAULT_LIGHT
    model: Path | None = None
    solver: SolverName = DEFAULT_SOLVER
    face: WhichFaces = 1
    head: HeadName = "fitted"
    decode: "Decode | None" = None
    landmarks: LandmarkerName = "mediapipe"
    ignore_exif_sun: bool = False
    keep_place: bool = False
    ground: KnownGround | None = None
    device: str = "auto"

    def __post_init__(self) -> None:
        check_light_name(self.light)
        check_solver_name(self.solver, self.light)
        check_has_ground(self.light, self.ground)
        if self.model is not None:
            check_is_trained(self.light)

    def facts(self) -> dict[str, object]:
        """For notes: the same for the same model files, wherever they lie, and on any device."""
        fingerprint = None
        if self.model is not None:
            from skylight.models.bundle import load_bundle

            fingerprint = load_bundle(self.model).fingerprint
        facts: dict[str, object] = {**asdict(self), "model": fingerprint}
        del facts["device"]
        if self.solver == DEFAULT_SOLVER:  # notes of runs before there was another
            del facts["solver"]
        if self.ground is None:
            del facts["ground"]
        return facts
