"""Previews of maps: exposed by the mean of log luminance, rolled off, in any units the same."""

import json

import numpy as np
import OpenEXR
import torch
from PIL import Image

from skylight.imaging._colour import linear_to_srgb
from skylight.imaging._preview import KEY, WHITE, preview, write_probe
from skylight.sphere._envmap import EnvironmentMap


def test_even_light_has_the_key():
    codes = preview(torch.full((32, 64, 3), 7.0))
    exposed = KEY / (1 + 1e-3)  # the dark that is added to the mean
    shown = exposed * (1 + exposed / WHITE**2) / (1 + exposed)
    expected = round(255 * float(linear_to_srgb(torch.tensor(shown))))
    assert (codes == expected).all()


def test_units_do_not_matter_and_a_sun_is_white():
    light = torch.rand(32, 64, 3, generator=torch.Generator().manual_seed(1)) + 0.1
    light[5, 9] = 1e5
    codes = preview(light)
    assert np.array_equal(codes, preview(1e-4 * light))
    assert (codes[5, 9] == 255).all()
    assert codes.max(axis=(0, 1)).min() == 255
    assert np.median(codes) < 200


def test_brighter_is_shown_brighter():
    levels = torch.logspace(-2, 2, 64)[None, :, None].expand(32, 64, 3)
    assert (np.diff(preview(levels)[0, :, 0].astype(int)) >= 0).all()


def test_a_probe_has_its_picture_and_its_lights(tmp_path):
    light = EnvironmentMap(radiance=torch.ones(16, 32, 3))
    write_probe(tmp_path, light, lights='[{"kind": "sun"}]')
    assert {path.name for path in tmp_path.iterdir()} == {"probe.exr", "probe.hdr", "probe.png"}
    header = OpenEXR.File(str(tmp_path / "probe.exr"), header_only=True).header()
    assert json.loads(header["lights"]) == [{"kind": "sun"}]
    assert np.array_equal(np.asarray(Image.open(tmp_path / "probe.png")), preview(light.radiance))
