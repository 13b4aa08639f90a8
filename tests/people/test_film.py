"""Path-traced films: a turned camera sees the light turned the other way."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from skylight.people._film import film_truth, textured
from skylight.people._light import DistantLight, RenderOptions, SunDisc
from skylight.people._people import person, seen_parts
from skylight.people._render import background
from skylight.people._subsurface import SkinPatches, patches_in_reach
from skylight.people._trace import trace
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid, rotation_about

OPTIONS = RenderOptions(size=40, samples=16, seed=7)
UP = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)


def uneven() -> EnvironmentMap:
    """Another radiance for every direction, brightest at one side."""
    directions = DirectionGrid.latlong(32).directions
    lobe = torch.exp(3 * (directions @ torch.tensor([0.9, 0.3, 0.3]).double() - 1))
    return EnvironmentMap(radiance=(0.2 + lobe)[:, None].repeat(1, 3).reshape(32, 64, 3).float())


def test_light_and_backdrop_of_a_turned_camera() -> None:
    """A quarter turn to the left is the same as light that is turned to the right by one."""
    turn = rotation_about(UP, math.pi / 2).numpy()
    sun, sun_around = (
        SunDisc(direction=torch.tensor(towards).double(), irradiance=torch.tensor([0.5, 0.4, 0.3]))
        for towards in ([0.0, 0.6, 0.8], [-0.8, 0.6, 0.0])
    )
    light = DistantLight(uneven(), sun)
    around = DistantLight(light.diffuse.rotate_azimuth(math.pi / 2), sun_around)
    who = person(0, 2.0, OPTIONS)
    camera = who.truth.camera
    np.testing.assert_allclose(
        background(light, camera, turn), background(around, camera), atol=2e-3
    )
    whole = vars(patches_in_reach(who, seen_parts(who), 0.01))
    patches = SkinPatches(**{name: values[::50] for name, values in whole.items()})
    moved = trace(who, light, patches, samples=16, seed=1, world_from_camera=turn)
    instead = trace(who, around, patches, samples=16, seed=1)
    still = trace(who, light, patches, samples=16, seed=1)
    skin = instead.cover > 0.99
    alike = np.corrcoef(moved.diffuse[skin, 1], instead.diffuse[skin, 1])[0, 1]
    assert alike > 0.99
    assert moved.diffuse[skin].mean() / instead.diffuse[skin].mean() - 1 < 0.02
    assert np.corrcoef(still.diffuse[skin, 1], instead.diffuse[skin, 1])[0, 1] < 0.9


def test_the_texture_is_fine_and_leaves_the_mean() -> None:
    even = EnvironmentMap(radiance=torch.ones(32, 64, 3))
    fine = textured(even, 0).radiance.log()
    assert fine.shape == (1024, 2048, 3)
    assert abs(float(fine.mean())) < 0.02
    assert 0.2 < float(fine.std()) < 0.6


def test_the_world_is_the_first_frames_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("skylight.people._light._FINER", 1)  # a coarse sky, found at once
    truth = film_truth(0, 5, replace(OPTIONS, skies="hosek-wilkie"))
    np.testing.assert_allclose(truth.world_from_camera[0], np.eye(3), atol=1e-12)
    assert len(truth.exposures) == 5
