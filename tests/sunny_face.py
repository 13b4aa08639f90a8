"""A rendered person under a clear sky whose sun is known, and an estimate of the light."""

from functools import lru_cache

import torch

from skylight.estimation._kept import FaceReflection, KeptFace
from skylight.estimation._photos import estimate_photo
from skylight.estimation._summary import PhotoEstimate
from skylight.faces._synthetic import SyntheticFace, render_face
from skylight.imaging._photo import photo_from_codes
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid, direction_from_angles

SKY, SUN = torch.tensor([0.105, 0.15, 0.24]), torch.tensor([2.2, 2.0, 1.7])


def direction(azimuth_deg: float, zenith_deg: float) -> torch.Tensor:
    angles = torch.tensor([azimuth_deg, zenith_deg], dtype=torch.float64).deg2rad()
    return direction_from_angles(*angles)


@lru_cache(maxsize=4)
def sunny_face(azimuth_deg: float, zenith_deg: float, *, seed: int = 3) -> SyntheticFace:
    """Even blue sky and a sun three degrees wide at that place in the camera's frame."""
    grid = DirectionGrid.sky(32)
    lobe = torch.exp(400 * (grid.directions @ direction(azimuth_deg, zenith_deg) - 1))
    lobe = (lobe / (lobe @ grid.solid_angles)).float()
    sky = EnvironmentMap(radiance=(SKY + lobe[:, None] * SUN).reshape(32, 128, 3))
    return render_face(sky, torch.full((3,), 0.2), seed=seed, azimuth_rad=0.0)


@lru_cache(maxsize=1)
def sunny_estimate() -> PhotoEstimate:
    """Of the face under a sun at (40, 50), by the quickest light model, made once a process."""
    return estimate_photo(sunny_face(40.0, 50.0).encoded, light="sh9", device="cpu")


@lru_cache(maxsize=1)
def sky_estimate() -> PhotoEstimate:
    """Of the same picture by Preetham's sky with its sun."""
    return estimate_photo(sunny_face(40.0, 50.0).encoded, light="sunsky", device="cpu", workers=1)


@lru_cache(maxsize=1)
def known_face() -> KeptFace:
    """A small picture under an even sky, as if head and light had been estimated without error."""
    sky = EnvironmentMap(radiance=SKY.expand(32, 128, 3).clone())
    face = render_face(sky, torch.full((3,), 0.2), seed=3, size=96, azimuth_rad=0.0, light_rows=32)
    return KeptFace(
        photo=photo_from_codes(face.encoded),
        name="me.png",
        fit=face.truth,
        reflection=FaceReflection(specular_scale=0.5, head_error=None),
        environment=face.environment,
        white_balance=torch.tensor([1.1, 1.0, 1 / 1.1]),
        lamps=(),
        verdict="direction good",
        advice=("a grey picture",),
        warning="",
    )
