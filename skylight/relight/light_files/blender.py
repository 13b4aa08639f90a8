"""Blender: the map as an .hdr, and a script that loads it as the world."""

from pathlib import Path

from skylight.io.atomic import atomic_path
from skylight.io.files import write_environment_map
from skylight.sphere.envmap import EnvironmentMap

SCRIPT, TEXTURE = "load_light.py", "blender_light.hdr"
# Blender has +Z up: (x, y, z) here is (x, -z, y) there, as its importers turn models with +Y up.
# The map is turned to Blender's own convention, so that it needs no mapping node.
_SCRIPT = f'''"""Light the scene with {TEXTURE}, which lies beside this file.

Run it as: blender --python {SCRIPT}, or open it in Blender's text editor and press Run. The camera
of the picture looked along Blender's +Y, with +Z up and +X to its right.
"""

from pathlib import Path

import bpy

folder = Path(__file__).parent
text = bpy.data.texts.get("{SCRIPT}")
if text is not None and text.filepath:  # run from the text editor
    folder = Path(bpy.path.abspath(text.filepath)).parent

world = bpy.data.worlds.new("skylight")
if world.node_tree is None:  # before Blender 5 worlds had none of their own accord
    world.use_nodes = True
bpy.context.scene.world = world
nodes, links = world.node_tree.nodes, world.node_tree.links
nodes.clear()
output = nodes.new("ShaderNodeOutputWorld")
background = nodes.new("ShaderNodeBackground")
picture = nodes.new("ShaderNodeTexEnvironment")
picture.image = bpy.data.images.load(str(folder / "{TEXTURE}"))
picture.projection = "EQUIRECTANGULAR"
links.new(picture.outputs["Color"], background.inputs["Color"])
links.new(background.outputs["Background"], output.inputs["Surface"])
'''


def write_blender(folder: Path, environment: EnvironmentMap) -> list[str]:
    """load_light.py and blender_light.hdr."""
    write_environment_map(folder / TEXTURE, environment, convention="blender")
    with atomic_path(folder / SCRIPT) as temporary:
        temporary.write_text(_SCRIPT, encoding="utf-8")
    return [SCRIPT, TEXTURE]
