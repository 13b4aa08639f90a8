# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene of Blender made like a portrait's: world, suns, camera, head. All of it or nothing."""

import math
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import bpy
import mathutils

from .run import Failure
from .scene_file import PortraitScene, Sun, read_head

NAME = "World from Portrait"
MARK = "world_from_portrait"  # a custom property of what a set-up made, which the next replaces
SENSOR_MM = 36.0
AWAY_M = 5.0  # where a sun's icon is drawn; its light is parallel
WHITE_NODE = "white"  # multiplies the world's light
# A value of the render then is shown as the photograph shows that value, by sRGB's curve alone.
# The last one is there since Blender 4.3.
DISPLAY = "sRGB"
VIEW = {
    "view_transform": "Standard",
    "look": "None",
    "exposure": 0.0,
    "gamma": 1.0,
    "use_curve_mapping": False,
    "use_white_balance": False,
}


def set_up(scene: bpy.types.Scene, portrait: PortraitScene) -> None:
    """Light and see the scene as the photograph was; what an earlier set-up made is replaced.

    Raises :class:`Failure`, and whatever Blender raises, with the scene as it was before.
    """
    if not hasattr(scene, "cycles"):
        raise Failure("Switch on the add-on Cycles Render Engine: the head's shadows need it")
    vertices, faces = read_head(portrait.head)
    earlier = [block for block in scene.collection.all_objects if block.get(MARK)]
    earlier_collections = [block for block in scene.collection.children if block.get(MARK)]
    with _all_or_nothing(scene) as made:
        collection = made(bpy.data.collections.new(NAME))
        photograph = _image(made, portrait.photograph)
        if tuple(photograph.size) != portrait.photograph_px:
            raise Failure(f"{portrait.photograph}: not the size that the scene says: export again")
        world = _world(made, portrait)
        camera = _camera(made, portrait, photograph)
        for block in (camera, _head(made, portrait, vertices, faces)):
            collection.objects.link(block)
        for sun in portrait.suns:
            collection.objects.link(_sun(made, sun))
        scene.collection.children.link(collection)
        scene.world, scene.camera = world, camera
        _see_as(scene, portrait)
        told = scene.world_from_portrait
        told.verdict, told.advice = portrait.verdict, "\n".join(portrait.advice)
        told.estimate = str(portrait.estimate) if portrait.estimate else ""
        told.white_found = portrait.white
        told.white = portrait.white
    _remove(earlier, earlier_collections)
    for block in made.blocks:  # those of before had the names
        block.name = re.sub(r"\.\d{3}$", "", block.name)


def light_as_white(told: Any, context: bpy.types.Context) -> None:
    """Multiply all light of the set-up so that white paint becomes what is called ``white``.

    The head stays as the photograph has it, but for two things: its albedo is divided by as much,
    which stops at 1, and its specular reflection grows with the light.
    """
    scene = told.id_data
    if not takes_white(scene):
        return
    world = _world_of_us(scene)
    # a channel without light stays without
    gains = [w / f if f > 0 else 1.0 for w, f in zip(told.white, told.white_found, strict=True)]
    if world is not None:
        world.nodes[WHITE_NODE].inputs[1].default_value = gains
    for block in (each for each in scene.collection.all_objects if each.get(MARK)):
        if block.type == "LIGHT" and "irradiance" in block.data:
            found = block.data["irradiance"]
            _shine(block.data, [gain * each for gain, each in zip(gains, found, strict=True)])
        elif block.type == "MESH" and "albedo" in (skin := block.active_material or {}):
            seen = zip(skin["albedo"], gains, strict=True)
            albedo = [min(each / gain, 1.0) if gain > 0 else each for each, gain in seen]
            for node in (each for each in skin.node_tree.nodes if each.type == "BSDF_PRINCIPLED"):
                node.inputs["Base Color"].default_value = (*albedo, 1.0)


def takes_white(scene: bpy.types.Scene) -> bool:
    """Whether the set-up tells its white, and its world can follow: not before extension 0.2.0."""
    world = _world_of_us(scene)
    can_follow = world is None or WHITE_NODE in world.nodes
    return can_follow and any(scene.world_from_portrait.white_found)


def _world_of_us(scene: bpy.types.Scene) -> Any:
    """The nodes of a set-up's world, None where the scene has another."""
    world = scene.world
    return world.node_tree if world is not None and world.get(MARK) else None


def shows_as_photographed(scene: bpy.types.Scene) -> bool:
    """Whether colours are still shown as a set-up has them shown."""
    view = scene.view_settings
    is_display = scene.display_settings.display_device == DISPLAY
    return is_display and all(getattr(view, name, value) == value for name, value in VIEW.items())


class _Made:
    """Marks data-blocks that are made, and notes them."""

    def __init__(self) -> None:
        self.blocks: list[Any] = []

    def __call__(self, block: Any) -> Any:
        block[MARK] = True
        self.blocks.append(block)
        return block


@contextmanager
def _all_or_nothing(scene: bpy.types.Scene) -> Iterator[_Made]:
    """An exception takes back what was made, and the scene's settings."""
    made = _Made()
    render, told = scene.render, scene.world_from_portrait
    settings = [
        (scene, "world"),
        (scene, "camera"),
        (render, "engine"),
        (render, "resolution_x"),
        (render, "resolution_y"),
        (render, "pixel_aspect_x"),
        (render, "pixel_aspect_y"),
        (render, "film_transparent"),
        (scene.display_settings, "display_device"),
        *((scene.view_settings, name) for name in VIEW if hasattr(scene.view_settings, name)),
        *((told, name) for name in ("verdict", "advice", "estimate", "white_found", "white")),
    ]
    before = [(owner, name, _value(getattr(owner, name))) for owner, name in settings]
    try:
        yield made
    except BaseException:
        for owner, name, value in before:
            setattr(owner, name, value)
        bpy.data.batch_remove(made.blocks)
        raise


def _value(of: Any) -> Any:
    """What a list of Blender's has now: it would follow."""
    return of[:] if hasattr(of, "__len__") else of


def _see_as(scene: bpy.types.Scene, portrait: PortraitScene) -> None:
    """Render at the photograph's size, its values as they are, with nothing behind."""
    render = scene.render
    render.engine = "CYCLES"
    render.resolution_x, render.resolution_y = portrait.photograph_px
    render.pixel_aspect_x = render.pixel_aspect_y = 1.0
    render.film_transparent = True
    try:
        scene.display_settings.display_device = DISPLAY
        for name, value in VIEW.items():
            if hasattr(scene.view_settings, name):
                setattr(scene.view_settings, name, value)
    except TypeError as error:
        raise Failure(
            'this colour management has no view "Standard" of sRGB: use Blender\'s'
        ) from error


def _image(made: _Made, path: Any) -> bpy.types.Image:
    try:
        image = made(bpy.data.images.load(str(path)))
    except RuntimeError as error:
        raise Failure(f"{path}: Blender cannot read it: estimate again") from error
    if 0 in image.size:  # it is decoded when its size is asked for
        raise Failure(f"{path}: Blender cannot read it: estimate again")
    return image


def _world(made: _Made, portrait: PortraitScene) -> bpy.types.World:
    world = made(bpy.data.worlds.new(NAME))
    nodes, links = _empty_nodes(world)
    output = nodes.new("ShaderNodeOutputWorld")
    background = nodes.new("ShaderNodeBackground")
    picture = nodes.new("ShaderNodeTexEnvironment")
    picture.image = _image(made, portrait.world)
    picture.projection = "EQUIRECTANGULAR"
    white = nodes.new("ShaderNodeVectorMath")
    white.name, white.operation = WHITE_NODE, "MULTIPLY"
    links.new(picture.outputs["Color"], white.inputs[0])
    links.new(white.outputs["Vector"], background.inputs["Color"])
    links.new(background.outputs["Background"], output.inputs["Surface"])
    return world


def _sun(made: _Made, sun: Sun) -> bpy.types.Object:
    light = made(bpy.data.lights.new(sun.name, "SUN"))
    light["irradiance"] = [sun.energy * channel for channel in sun.colour]
    light.angle = sun.angle_rad
    _shine(light, light["irradiance"])
    lamp = made(bpy.data.objects.new(sun.name, light))
    towards = mathutils.Vector(sun.towards)
    lamp.rotation_euler = towards.to_track_quat("Z", "Y").to_euler()  # it shines along its -Z
    lamp.location = AWAY_M * towards
    return lamp


def _shine(light: Any, irradiance: Sequence[float]) -> None:
    """Of a surface that faces it; Blender's colours go up to 1."""
    light.energy = max(irradiance)
    light.color = [channel / (light.energy or 1.0) for channel in irradiance]


def _camera(made: _Made, portrait: PortraitScene, photograph: bpy.types.Image) -> bpy.types.Object:
    data = made(bpy.data.cameras.new("portrait camera"))
    data.sensor_fit, data.sensor_width = "HORIZONTAL", SENSOR_MM
    data.lens = SENSOR_MM * portrait.focal_length_px / portrait.photograph_px[0]
    data.clip_start = 0.01
    data.show_background_images = True
    behind = data.background_images.new()
    behind.image, behind.alpha = photograph, 1.0
    camera = made(bpy.data.objects.new("portrait camera", data))
    camera.rotation_euler = math.pi / 2, 0, 0  # from down, -Z, to ahead, +Y
    return camera


def _head(
    made: _Made, portrait: PortraitScene, vertices: list[Any], faces: list[Any]
) -> bpy.types.Object:
    mesh = made(bpy.data.meshes.new("portrait head"))
    mesh.from_pydata(vertices, [], faces)
    mesh.polygons.foreach_set("use_smooth", [True] * len(mesh.polygons))
    skin = made(bpy.data.materials.new("portrait skin"))
    nodes, links = _empty_nodes(skin)
    surface, output = nodes.new("ShaderNodeBsdfPrincipled"), nodes.new("ShaderNodeOutputMaterial")
    skin["albedo"] = portrait.albedo
    surface.inputs["Base Color"].default_value = (*portrait.albedo, 1.0)
    surface.inputs["IOR"].default_value = portrait.ior
    surface.inputs["Roughness"].default_value = portrait.roughness
    links.new(surface.outputs["BSDF"], output.inputs["Surface"])
    mesh.materials.append(skin)
    head = made(bpy.data.objects.new("portrait head", mesh))
    head.is_shadow_catcher = True
    return head


def _empty_nodes(block: Any) -> tuple[Any, Any]:
    if block.node_tree is None:  # before Blender 5 there are none of their own accord
        block.use_nodes = True
    block.node_tree.nodes.clear()
    return block.node_tree.nodes, block.node_tree.links


def _remove(objects: list[Any], collections: list[Any]) -> None:
    """What an earlier set-up made, but not what was put into its collection since."""
    bpy.data.batch_remove(objects)
    bpy.data.batch_remove([block for block in collections if not block.all_objects])
    # what they used, each before what it uses itself
    for kind in ("meshes", "lights", "cameras", "materials", "worlds", "images"):
        blocks = getattr(bpy.data, kind)
        bpy.data.batch_remove([block for block in blocks if block.get(MARK) and not block.users])
