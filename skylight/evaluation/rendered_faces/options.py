"""Options of rendered faces."""

from dataclasses import asdict, dataclass, replace
from typing import Literal

from skylight.evaluation.rendered_faces.map_folder import MapFolder

# Whose skies: those of the simulator that light models are fitted to, or another model's.
Skies = Literal["simulated", "hosek-wilkie"]


@dataclass(frozen=True, kw_only=True)
class RenderOptions:
    """``size`` px square, ``samples`` light paths per pixel and layer.

    Face i belongs to scene i // ``per_scene``: one sky, ground, camera and exposure. ``hair`` puts
    a cap on every head. Simulated days are of all kinds, as the thesis scores them (5.5.1);
    ``sunny`` keeps those whose sun is visible. With ``maps``, scene i is lit by map i modulo their
    count, turned about the vertical by a random angle, in place of a sky. With ``light_seed`` the
    light is that of this other seed, while people, poses and cameras stay those of ``seed``.
    """

    size: int = 288
    samples: int = 64
    seed: int = 0
    per_scene: int = 1
    hair: bool = False
    sunny: bool = False
    skies: Skies = "simulated"
    maps: MapFolder | None = None
    light_seed: int | None = None

    def settings(self) -> dict[str, object]:
        """What faces depend on, for files: maps by their content, wherever they lie."""
        settings = asdict(replace(self, maps=None))
        del settings["maps"]
        if self.light_seed is None:  # as faces had it that were rendered before it existed
            del settings["light_seed"]
        if self.maps is not None:
            settings["maps"] = {"count": len(self.maps.files), "sha256": self.maps.sha256}
        return settings
