"""Nine spherical harmonic coefficients as JSON, in a named convention."""

from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.io.json_files import write_json
from skylight.sphere.envmap import EnvironmentMap
from skylight.sphere.harmonic_conventions import HarmonicConvention, to_convention
from skylight.sphere.harmonics import project

HARMONICS = "sh27.json"
_STANDS_FOR = {
    "skylight": "radiance, RGB by coefficient (0,0) (1,-1) (1,0) (1,1) (2,-2) ... (2,2)",
    "threejs": "radiance, RGB by coefficient (0,0) (1,-1) (1,0) (1,1) (2,-2) ... (2,2)",
    "arcore": "radiance, RGB by coefficient, a minus for odd m (Condon-Shortley)",
    "arkit": "radiance, nine of red, nine of green, nine of blue",
    "gltf": "irradiance, RGB by coefficient, a minus for negative m",
}


def second_degree(environment: EnvironmentMap) -> Float[Tensor, "9 3"]:
    """Coefficients of radiance up to degree 2 in :mod:`skylight.sphere.harmonics`' basis."""
    return project(environment.flat.double(), environment.grid, 2)


def rounded(coefficients: Float[Tensor, "9 3"], convention: HarmonicConvention) -> list[float]:
    """As float32 has them, which is what their readers store."""
    return to_convention(coefficients, convention).to(torch.float32).tolist()


def write_harmonics(
    folder: Path, environment: EnvironmentMap, convention: HarmonicConvention
) -> list[str]:
    """sh27.json: the numbers, and what they stand for."""
    content = {
        "format": "skylight sh27 1",
        "convention": convention,
        "numbers_are": _STANDS_FOR[convention],
        "axes": "right-handed, +Y up, the camera looks along -Z",
        "sh": rounded(second_degree(environment), convention),
    }
    write_json(folder / HARMONICS, content)
    return [HARMONICS]
