"""The same scene with the sun on the left, ahead and on the right; torch is never imported.

    skylight export decoder --out sky_decoder.onnx
    skylight export scene bunny.obj --out bunny.npz
    python examples/relight_without_torch.py bunny.npz sky_decoder.onnx latent.json

The last line runs on a machine without torch too, after `pip install ./relight`.
"""

import math
import sys

from PIL import Image

from skylight.relight._decoder import SkyDecoder, read_latent
from skylight.relight._runtime import (
    GROUND_ALBEDO,
    add_ground,
    load_scene,
    relight,
    rotate_columns,
    tone_map,
)

scene_path, decoder_path, latent_path = sys.argv[1:]
scene, decoder = load_scene(scene_path), SkyDecoder(decoder_path)
sky = decoder.decode(read_latent(latent_path).z[None])[0]  # (32, 128, 3)
for azimuth_deg in (-90, 0, 90):
    turned = rotate_columns(sky, math.radians(azimuth_deg) - decoder.centre_azimuth_rad)
    picture = relight(scene, add_ground(turned, (GROUND_ALBEDO,) * 3))
    Image.fromarray(tone_map(picture)).save(f"relit{azimuth_deg:+d}.png")

assert "torch" not in sys.modules
