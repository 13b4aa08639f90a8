"""Folders of faces as ``skylight faces render`` writes them, without its renderer."""

from dataclasses import fields
from pathlib import Path

import numpy as np

from skylight.faces._synthetic import SyntheticFace
from skylight.people._files import write_rendered_face
from skylight.people._light import RenderOptions
from skylight.people._maps import TurnedMap
from skylight.people._render import RenderedFace


def write_face(
    folder: Path, number: int, face: SyntheticFace, turned: TurnedMap | None = None
) -> Path:
    """A person of a scene, a skin tone and a number of its own, under no simulated sky.

    Hair is said to be in the upper eighth of the picture.
    """
    size = len(face.encoded)
    hair = np.zeros((size, size), bool)
    hair[: size // 8] = True
    out = folder / f"face{number:04d}"
    out.mkdir(parents=True)
    rendered = RenderedFace(
        **{each.name: getattr(face, each.name) for each in fields(SyntheticFace)},
        linear=face.picture,
        landmarks=np.zeros((68, 2)),
        hair=hair,
        cluster=number,
        number=number,
        scene=number,
        sky_seed=None,
        sun_direction=None,
        sun_transmittance=None,
        exposure=1.0,
        turned_map=turned,
    )
    write_rendered_face(out, rendered, RenderOptions(size=size))
    return folder
