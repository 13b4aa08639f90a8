"""Other programs, where they are installed, on the files that are written for them."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

# The scene with the light of load_light.py, a camera of a long lens, and how a picture is taken
_LOADED = """
import json, math, runpy, sys
import bpy, mathutils
import numpy as np
folder, asked = sys.argv[1], json.loads(sys.argv[2])
bpy.ops.wm.read_factory_settings(use_empty=True)
runpy.run_path(folder + "/load_light.py")
scene = bpy.context.scene
scene.render.engine = "CYCLES"
scene.cycles.use_denoising = False
scene.render.resolution_x = scene.render.resolution_y = 4
scene.view_settings.view_transform = "Raw"
scene.render.image_settings.file_format = "OPEN_EXR"
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
camera.data.lens = 500
scene.collection.objects.link(camera)
scene.camera = camera
def picture(name):
    scene.render.filepath = folder + "/" + name + ".exr"
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath, check_existing=False)
    return np.array(image.pixels[:]).reshape(4, 4, 4)
"""


def seen_by_blender(folder: Path, script: str, asked: object) -> Any:
    """What ``script`` leaves as ``seen`` of the light in ``folder``; ``asked`` is given to it."""
    if importlib.util.find_spec("bpy") is None:
        pytest.skip("Blender's module bpy is not installed")
    program = _LOADED + script + '\nprint("SEEN", json.dumps(seen))\n'
    ended = subprocess.run(
        [sys.executable, "-c", program, str(folder), json.dumps(asked)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    lines = [line for line in ended.stdout.splitlines() if line.startswith("SEEN ")]
    assert lines, ended.stderr
    return json.loads(lines[0][5:])


def mitsuba() -> Any:
    """Mitsuba's module, in its scalar variant."""
    mi = pytest.importorskip("mitsuba", reason="mitsuba is not installed")
    if "scalar_rgb" not in mi.variants():
        pytest.skip("this mitsuba has no scalar_rgb variant")
    mi.set_variant("scalar_rgb")
    return mi
