"""Options of rendered faces."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class RenderOptions:
    """``size`` px square, ``samples`` light paths per pixel and layer.

    Face i belongs to scene i // ``per_scene``: one sky, ground, camera and exposure. ``hair`` puts
    a cap on every head. Test days are of all kinds, as the thesis scores them (5.5.1); ``sunny``
    keeps those whose sun is visible.
    """

    size: int = 288
    samples: int = 64
    seed: int = 0
    per_scene: int = 1
    hair: bool = False
    sunny: bool = False
