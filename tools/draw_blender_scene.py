"""The picture of docs/blender.md: a photograph, and things that Blender's extension put into it.

    PYTHONPATH=FOLDER python -m tools.draw_blender_scene

FOLDER has Blender's module: ``pip install --target FOLDER --no-deps 'bpy==4.2.*'``, by Python 3.11.
Estimates the light of a rendered face, exports it, lets the extension set up a scene in a process
of its own, adds three balls and a ring, renders these by Cycles and lays them over the photograph.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "images" / "blender_scene.png"
SIZE, SEED = 512, 12
SUN_DEG = 128.0, 48.0  # azimuth and zenith: behind the camera, right
SAMPLES = 64
BALL_M, RING_M, TUBE_M = 0.03, 0.105, 0.01


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        draw(place)


def draw(place: Path) -> None:
    import torch

    from skylight.cli import main as skylight
    from skylight.imaging._colour import linear_to_srgb, srgb_to_linear
    from skylight.io._files import write_png

    photo, estimate, scene = place / "photo.png", place / "estimate", place / "scene"
    write_png(photo, face())
    assert skylight(["estimate", str(photo), "--out", str(estimate)]) == 0
    assert skylight(["export", "blender", str(estimate), str(scene)]) == 0
    command = [sys.executable, __file__, str(scene), str(place / "things.exr")]
    subprocess.run(command, check=True)
    things = torch.from_numpy(np.load(place / "things.npy")).float()
    plate = srgb_to_linear(torch.from_numpy(face()).float() / 255)
    over = things[..., :3] + (1 - things[..., 3:]) * plate
    shown = (255 * linear_to_srgb(torch.cat([plate, over], 1).clamp(0, 1))).round()
    write_png(PICTURE, shown.to(torch.uint8).numpy())


def face() -> np.ndarray:
    """A person whom the sun shines on from behind the camera."""
    import torch

    from skylight.faces._synthetic import render_face
    from skylight.sphere._envmap import EnvironmentMap
    from skylight.sphere._frame import DirectionGrid, direction_from_angles

    grid = DirectionGrid.sky(32)
    sun = direction_from_angles(*torch.tensor(SUN_DEG, dtype=torch.float64).deg2rad())
    lobe = torch.exp(400 * (grid.directions @ sun - 1))
    lobe = (lobe / (lobe @ grid.solid_angles)).float()
    radiance = torch.tensor([0.105, 0.15, 0.24]) + lobe[:, None] * torch.tensor([2.2, 2.0, 1.7])
    sky = EnvironmentMap(radiance=radiance.reshape(32, 128, 3))
    ground = torch.full((3,), 0.2)
    return render_face(sky, ground, seed=SEED, size=SIZE, azimuth_rad=0.0).encoded


def in_blender(scene: Path, out: Path) -> None:
    """Set up by the extension, with things of our own, rendered into an .exr and an array."""
    sys.path.insert(0, str(ROOT / "blender"))
    import bpy
    from world_from_portrait import registration

    bpy.ops.wm.read_factory_settings(use_empty=True)
    registration.register()
    bpy.ops.world_from_portrait.set_up(folder=str(scene))
    head = bpy.data.objects["portrait head"]
    corners = np.array([vertex.co for vertex in head.data.vertices])
    low, high = corners.min(0), corners.max(0)
    middle = (low + high) / 2
    lens = bpy.context.scene.camera.data
    aside = middle[1] * lens.sensor_width / (2 * lens.lens) - 1.2 * BALL_M  # near the border
    for place, colour, metallic, roughness in (
        ((aside, middle[1], middle[2] + 2 * BALL_M), 0.8, 0.0, 1.0),
        ((aside, middle[1], middle[2] - BALL_M), 0.9, 1.0, 0.0),
        ((-aside, middle[1], middle[2]), 0.18, 0.0, 1.0),
    ):
        bpy.ops.mesh.primitive_uv_sphere_add(
            segments=96, ring_count=48, radius=BALL_M, location=place
        )
        _finish(colour, metallic, roughness)
    bpy.ops.mesh.primitive_torus_add(
        major_radius=RING_M,
        minor_radius=TUBE_M,
        major_segments=128,
        minor_segments=32,
        location=(middle[0], middle[1], high[2] - 0.03),
    )
    _finish(0.5, 0.0, 0.6)
    shown = bpy.context.scene
    shown.cycles.samples, shown.cycles.use_denoising = SAMPLES, True
    shown.render.image_settings.file_format = "OPEN_EXR"
    shown.render.filepath = str(out)
    bpy.ops.render.render(write_still=True)
    picture = bpy.data.images.load(str(out))
    width, height = picture.size
    pixels = np.array(picture.pixels[:], np.float32).reshape(height, width, 4)[::-1]
    np.save(out.with_suffix(".npy"), pixels)
    registration.unregister()  # Blender ends badly with classes that are still known


def _finish(colour: float, metallic: float, roughness: float) -> None:
    """Give what was just added a material, and smooth shading."""
    import bpy

    thing = bpy.context.object
    thing.data.polygons.foreach_set("use_smooth", [True] * len(thing.data.polygons))
    material = bpy.data.materials.new("thing")
    if material.node_tree is None:
        material.use_nodes = True
    (surface,) = [n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED"]
    surface.inputs["Base Color"].default_value = colour, colour, colour, 1
    surface.inputs["Metallic"].default_value = metallic
    surface.inputs["Roughness"].default_value = roughness
    thing.data.materials.append(material)


if __name__ == "__main__":
    if len(sys.argv) == 3:
        in_blender(Path(sys.argv[1]), Path(sys.argv[2]))
    else:
        main()
