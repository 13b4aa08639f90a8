"""What tests ask of Blender itself, by its module bpy, in a process of its own::

    python in_blender.py CHECK '{"zip": "world_from_portrait-0.2.0.zip", ...}'

installs the extension's zip as a user would, does the check and prints FOUND and its answer as
JSON. Nothing of skylight is imported here.
"""

import json
import math
import os
import sys
import time
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import mathutils
import numpy as np

ID = "world_from_portrait"
Asked = dict[str, Any]


def main() -> None:
    check, asked = CHECKS[sys.argv[1]], json.loads(sys.argv[2])
    bpy.ops.wm.read_factory_settings()
    bpy.ops.extensions.package_install_files(
        filepath=asked["zip"], repo="user_default", enable_on_install=True
    )
    print("FOUND", json.dumps(check(asked)))


def module(name: str) -> Any:
    """A module of the extension, under the name that Blender gave it."""
    addons = bpy.context.preferences.addons
    (package,) = [each.module for each in addons if each.module.endswith(ID)]
    return sys.modules[f"{package}.{name}"] if name else package


# what is set up


def set_up(asked: Asked) -> Asked:
    bpy.ops.world_from_portrait.set_up(folder=asked["folder"])
    scene = bpy.context.scene
    camera, head = scene.camera, bpy.data.objects["portrait head"]
    background = camera.data.background_images[0]
    nodes = scene.world.node_tree.nodes
    (picture,) = [node for node in nodes if node.type == "TEX_ENVIRONMENT"]
    return {
        "suns": [_sun(block) for block in _of_us() if block.type == "LIGHT"],
        "world_image": picture.image.filepath,
        "world_colours": picture.image.colorspace_settings.name,
        "photograph": background.image.filepath,
        "photograph_px": list(background.image.size),
        "photograph_colours": background.image.colorspace_settings.name,
        "photograph_is_shown": camera.data.show_background_images,
        "resolution": [scene.render.resolution_x, scene.render.resolution_y],
        "engine": scene.render.engine,
        "film_transparent": scene.render.film_transparent,
        "view": scene.view_settings.view_transform,
        "catches_shadows": head.is_shadow_catcher,
        "pixels": _seen_at(head),
        "verdict": scene.world_from_portrait.verdict,
        "advice": scene.world_from_portrait.advice,
    }


def _of_us() -> list[bpy.types.Object]:
    return [block for block in bpy.context.scene.objects if block.get(ID)]


def _sun(lamp: bpy.types.Object) -> Asked:
    towards = lamp.matrix_world.to_3x3() @ mathutils.Vector((0, 0, 1))
    light = lamp.data
    return {
        "name": lamp.name,
        "towards": list(towards),
        "irradiance": [light.energy * channel for channel in light.color],
        "angle_rad": light.angle,
    }


def _seen_at(head: bpy.types.Object) -> list[list[float]]:
    """Pixels (x, y) of the head's vertices by the matrices with which Blender draws and renders."""
    scene, graph = bpy.context.scene, bpy.context.evaluated_depsgraph_get()
    width, height = scene.render.resolution_x, scene.render.resolution_y
    camera = scene.camera.evaluated_get(graph)
    projection = camera.calc_matrix_camera(graph, x=width, y=height)
    whole = np.array(projection @ camera.matrix_world.inverted() @ head.matrix_world)
    points = np.array([(*vertex.co, 1.0) for vertex in head.data.vertices]) @ whole.T
    x, y = points[:, 0] / points[:, 3], points[:, 1] / points[:, 3]
    return np.stack([(x + 1) / 2 * width, (1 - y) / 2 * height], 1).tolist()


# light


def irradiance(asked: Asked) -> list[list[float]]:
    """Of white planes that face each of the normals (Blender's axes): pi times what is rendered."""
    bpy.ops.world_from_portrait.set_up(folder=asked["folder"])
    _hide_all_but_lamps_of_us()
    scene = bpy.context.scene
    scene.cycles.samples, scene.cycles.use_denoising = asked["samples"], False
    scene.render.resolution_x = scene.render.resolution_y = 4
    bpy.ops.mesh.primitive_plane_add(size=1)
    plane = bpy.context.object
    plane.data.materials.append(_white())
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.lens = 500
    scene.collection.objects.link(camera)
    scene.camera = camera
    seen = []
    for normal in asked["normals"]:
        towards = mathutils.Vector(normal)
        plane.rotation_euler = camera.rotation_euler = towards.to_track_quat("Z", "Y").to_euler()
        camera.location = 3 * towards
        picture = _rendered(asked["out"])
        seen.append((math.pi * picture[..., :3].mean((0, 1))).tolist())
    return seen


def _hide_all_but_lamps_of_us() -> None:
    for block in bpy.context.scene.objects:
        block.hide_render = not block.get(ID) or block.type != "LIGHT"


def _white() -> bpy.types.Material:
    white = bpy.data.materials.new("white")
    if white.node_tree is None:
        white.use_nodes = True
    nodes = white.node_tree.nodes
    nodes.clear()
    diffuse, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
    diffuse.inputs["Color"].default_value = 1, 1, 1, 1
    white.node_tree.links.new(diffuse.outputs["BSDF"], output.inputs["Surface"])
    return white


def _rendered(path: str) -> np.ndarray:
    """(h, w, 4) linear, the first row on top."""
    scene = bpy.context.scene
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.filepath = path
    bpy.ops.render.render(write_still=True)
    picture = bpy.data.images.load(path, check_existing=False)
    width, height = picture.size
    pixels = np.array(picture.pixels[:]).reshape(height, width, 4)[::-1]
    bpy.data.images.remove(picture)
    return pixels


def head_rendered(asked: Asked) -> list[int]:
    """The head, as a thing like others and not a shadow catcher, seen by the portrait's camera."""
    bpy.ops.world_from_portrait.set_up(folder=asked["folder"])
    scene = bpy.context.scene
    scene.cycles.samples, scene.cycles.use_denoising = asked["samples"], False
    for block in scene.objects:
        block.hide_render = not block.get(ID)
    bpy.data.objects["portrait head"].is_shadow_catcher = False
    pixels = _rendered(asked["out"])
    np.save(Path(asked["out"]).with_suffix(".npy"), pixels)
    return list(pixels.shape)


# colours


def colours(asked: Asked) -> Asked:
    """White paint that faces the camera, as the set-up shows it and lit as its white is picked."""
    scene = bpy.context.scene
    view = scene.view_settings
    view.view_transform = "AgX"
    view.look, view.exposure, view.gamma = "AgX - Punchy", 1.5, 1.7
    view.use_curve_mapping = True
    if hasattr(view, "use_white_balance"):
        view.use_white_balance = True
    bpy.ops.world_from_portrait.set_up(folder=asked["folder"])
    told, found = scene.world_from_portrait, {}
    found["told"] = list(told.white)
    found["first"] = _white_shown(asked)
    told.white = asked["picked"]
    found["picked"] = _white_shown(asked)
    head = bpy.data.objects["portrait head"].active_material.node_tree.nodes["Principled BSDF"]
    found["albedo"] = list(head.inputs["Base Color"].default_value)[:3]
    bpy.ops.world_from_portrait.set_up(folder=asked["folder"])
    found["again"] = list(told.white)
    return found


def views(asked: Asked) -> dict[str, list[bool]]:
    """Whether colours are shown as the photograph's: once each is changed, and set up again."""
    scene, setup = bpy.context.scene, module("scene_setup")
    others = {"display_device": "Display P3", "view_transform": "Raw", "look": "High Contrast"}
    found = {}
    for name in ("display_device", *setup.VIEW):
        bpy.ops.world_from_portrait.set_up(folder=asked["folder"])
        owner = scene.display_settings if name == "display_device" else scene.view_settings
        if not hasattr(owner, name):
            continue
        was, first = getattr(owner, name), setup.shows_as_photographed(scene)
        other = not was if isinstance(was, bool) else others.get(name, 0.5)
        setattr(owner, name, other)
        if name == "display_device":  # it may change the view
            scene.view_settings.view_transform = "Standard"
        found[name] = [first, getattr(owner, name) != was, setup.shows_as_photographed(scene)]
    return found


def older(asked: Asked) -> Asked:
    """A scene as extension 0.1.1 set it up, without its white; then set up again."""
    scene, setup, panels = bpy.context.scene, module("scene_setup"), module("panels")
    told, found = scene.world_from_portrait, {}

    def note(name: str) -> None:
        drawn = _Noted()
        panels._colours(drawn, scene, 1000)
        setup.light_as_white(told, bpy.context)  # errors in updates are printed, and no more
        suns = [_sun(block) for block in _of_us() if block.type == "LIGHT"]
        irradiance = {sun["name"]: sun["irradiance"] for sun in suns}
        found[name] = {"irradiance": irradiance, "drawn": drawn.said}

    bpy.ops.world_from_portrait.set_up(folder=asked["folder"])
    note("new")
    nodes = scene.world.node_tree.nodes
    nodes.remove(nodes["white"])
    for block in _of_us():
        if block.type == "LIGHT":
            del block.data["irradiance"]
    told.white_found = told.white = 0, 0, 0
    note("older")
    told.white = asked["picked"]
    note("older_picked")
    bpy.ops.world_from_portrait.set_up(folder=asked["folder"])
    note("again")
    told.white = [2 * each for each in told.white_found]
    lamp = bpy.data.objects.new("added", bpy.data.lights.new("added", "SUN"))
    lamp.data.energy, lamp[ID] = 3.0, True
    scene.collection.objects.link(lamp)
    note("again_twice")
    return found


class _Noted:
    """A layout that notes what is drawn."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def column(self, align: bool = False) -> "_Noted":
        return self

    def prop(self, owner: Any, name: str) -> None:
        self.said.append(name)

    def label(self, text: str, icon: str) -> None:
        self.said.append(text)


def _white_shown(asked: Asked) -> list[float]:
    """The 8-bit values, 0 to 1, of an .png of a plane of reflectance 0.8 before the camera."""
    scene = bpy.context.scene
    for block in scene.objects:
        block.hide_render = not block.get(ID) or block.type != "LIGHT"
    scene.cycles.samples, scene.cycles.use_denoising = asked["samples"], False
    scene.render.resolution_x = scene.render.resolution_y = 4
    scene.render.dither_intensity = 0.0
    bpy.ops.mesh.primitive_plane_add(size=100, location=(0, 50, 0), rotation=(math.pi / 2, 0, 0))
    plane = bpy.context.object
    plane.data.materials.append(_white())
    (diffuse,) = [n for n in plane.active_material.node_tree.nodes if n.type == "BSDF_DIFFUSE"]
    diffuse.inputs["Color"].default_value = 0.8, 0.8, 0.8, 1
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGB"
    scene.render.filepath = asked["out"]
    bpy.ops.render.render(write_still=True)
    picture = bpy.data.images.load(asked["out"], check_existing=False)
    codes = np.array(picture.pixels[:]).reshape(-1, 4)  # of 8 bits: as they are in the file
    bpy.data.images.remove(picture)
    bpy.data.objects.remove(plane)
    return codes[:, :3].mean(0).tolist()


# nothing half made


def refusals(asked: Asked) -> list[Asked]:
    """Of folders that cannot be set up: what is told, and whether anything is other than before."""
    if asked["first"]:
        bpy.ops.world_from_portrait.set_up(folder=asked["first"])
    found = []
    for folder in asked["folders"]:
        before = state()
        found.append(_refusal(folder) | {"is_unchanged": state() == before})
    return found


def _refusal(folder: str) -> Asked:
    try:
        bpy.ops.world_from_portrait.set_up(folder=folder)
    except RuntimeError as error:
        return {"error": str(error).strip(), "panel": module("running").message}
    return {"error": "", "panel": module("running").message}


def without_cycles(asked: Asked) -> Asked:
    bpy.ops.preferences.addon_disable(module="cycles")
    before = state()
    return _refusal(asked["folder"]) | {"is_unchanged": state() == before}


def broken_off(asked: Asked) -> Asked:
    """An exception at the very end of a set-up: the engine cannot be set any more."""
    scene_setup = module("scene_setup")
    before = state()
    real = scene_setup._see_as

    def then_fails(scene: bpy.types.Scene, portrait: Any) -> None:
        real(scene, portrait)
        raise KeyboardInterrupt

    scene_setup._see_as = then_fails
    folder = Path(asked["folder"])
    try:
        scene_setup.set_up(bpy.context.scene, module("scene_file").read_scene(folder))
    except KeyboardInterrupt:
        return {"is_unchanged": state() == before}
    return {"is_unchanged": None}


def again(asked: Asked) -> Asked:
    """A second set-up takes the place of the first, but leaves what was put beside it."""
    bpy.ops.world_from_portrait.set_up(folder=asked["folder"])
    first = state()
    bpy.ops.world_from_portrait.set_up(folder=asked["folder"])
    is_same = _names(first) == _names(state())
    ours = bpy.data.collections["World from Portrait"]
    hat = bpy.data.objects.new("hat", None)
    ours.objects.link(hat)
    bpy.ops.world_from_portrait.set_up(folder=asked["folder"])
    return {
        "is_same": is_same,
        "hat_is_there": hat.name in bpy.context.scene.objects,
        "heads": sum("portrait head" in block.name for block in bpy.context.scene.objects),
    }


def undo(asked: Asked) -> Asked:
    bpy.ops.ed.undo_push(message="before")
    before = state()
    bpy.ops.world_from_portrait.set_up("EXEC_DEFAULT", True, folder=asked["folder"])
    after = state()
    bpy.ops.ed.undo()
    undone = state()
    bpy.ops.ed.redo()
    return {
        "changed": after != before,
        "undone": undone == before,
        "redone": state()["objects"] == after["objects"],
    }


def state() -> Asked:
    """Everything that a set-up changes, of the scene and of the file's data."""
    scene = bpy.context.scene
    return {
        "data": {name: sorted(block.name for block in blocks) for name, blocks in _data()},
        "objects": sorted(block.name for block in scene.objects),
        "collections": sorted(block.name for block in scene.collection.children),
        "world": scene.world.name if scene.world else None,
        "camera": scene.camera.name if scene.camera else None,
        "render": [
            scene.render.engine,
            scene.render.resolution_x,
            scene.render.resolution_y,
            scene.render.film_transparent,
            scene.display_settings.display_device,
            *(
                getattr(scene.view_settings, name)
                for name in ("view_transform", "look", "exposure")
            ),
        ],
        "told": [
            getattr(scene.world_from_portrait, name) for name in ("verdict", "advice", "estimate")
        ],
        "white": list(scene.world_from_portrait.white),
    }


def _data() -> Iterator[tuple[str, Any]]:
    for name in ("objects", "lights", "cameras", "meshes", "materials", "worlds", "images",
                 "collections"):  # fmt: skip
        yield name, getattr(bpy.data, name)


def _names(of: Asked) -> list[str]:
    """Of the scene's objects, without the number that Blender adds to the second of a name."""
    return sorted(name.split(".")[0] for name in of["objects"])


# runs of skylight


def runs(asked: Asked) -> list[Asked]:
    """Photographs in turn, each as the button does it; the timer is called as Blender would."""
    preferences = bpy.context.preferences.addons[module("")].preferences
    found = []
    for one in asked["runs"]:
        preferences.program = one["program"]
        settings = bpy.context.scene.world_from_portrait
        settings.photo, settings.folder = one.get("photo", ""), one.get("out", "")
        settings.light = one.get("light", "autoencoder")
        before = state()
        told = _run(one)
        images = {image.name: list(image.size) for image in bpy.data.images}
        shown = [a.spaces.active.image for a in _image_editors() if a.spaces.active.image]
        found.append(
            told
            | {"is_unchanged": state() == before, "verdict": settings.verdict, "images": images}
            | {"shown": [image.name for image in shown]}
        )
        if one.get("editor"):  # from now on there is one
            bpy.context.window_manager.windows[0].screen.areas[0].type = "IMAGE_EDITOR"
    return found


def _image_editors() -> list[bpy.types.Area]:
    windows = bpy.context.window_manager.windows
    return [a for w in windows for a in w.screen.areas if a.type == "IMAGE_EDITOR"]


def pictures(asked: Asked) -> list[Asked]:
    """Portraits that each of the programs relights, into the folder of an estimate."""
    preferences = bpy.context.preferences.addons[module("")].preferences
    bpy.context.scene.world_from_portrait.estimate = asked["estimate"]
    found = []
    for program in asked["programs"]:
        preferences.program = program
        found.append(_run({"key": "top", "size_deg": 25.0})["panel"])
    return found


def _run(one: Asked) -> Asked:
    running = module("running")
    operators = bpy.ops.world_from_portrait
    try:
        if "key" in one:
            asked = bpy.context.scene.world_from_portrait
            asked.key, asked.size_deg, asked.strength = one["key"], one["size_deg"], 6.0
            operators.relight()
        elif "estimate" in one:
            operators.open_estimate(directory=one["estimate"])
        else:
            operators.estimate()
    except RuntimeError as error:
        return {"error": str(error).strip(), "panel": running.message, "stages": []}
    stages: list[str] = []
    while running.tick() is not None:
        watched = running.current
        if watched.run.stage not in stages:
            stages.append(watched.run.stage)
        if watched.run.stage == one.get("cancel_at"):
            operators.cancel()
        time.sleep(0.02)
    return {"error": "", "panel": running.message, "stages": stages}


def left_behind(asked: Asked) -> Asked:
    """A run goes on when another file is opened, or the extension is switched off."""
    preferences = bpy.context.preferences.addons[module("")].preferences
    preferences.program = asked["program"]
    running, found = module("running"), []
    for end in (
        bpy.ops.wm.read_homefile,
        lambda: bpy.ops.preferences.addon_disable(module=module("")),
    ):
        bpy.context.scene.world_from_portrait.photo = asked["photo"]
        bpy.ops.world_from_portrait.estimate()
        process = running.current.run._process
        was_running = process.poll() is None
        end()
        found.append([was_running, process.poll() is not None, running.current is None])
    return {"ends": found, "is_gone": not hasattr(bpy.types.Scene, ID)}


def drawn(asked: Asked) -> None:
    """Both panels, while skylight runs and after; ends the process, as Blender fails next.

    Without a window a popup is drawn as ever, but cannot be shown.
    """
    preferences = bpy.context.preferences.addons[module("")].preferences
    preferences.program = asked["program"]
    settings = bpy.context.scene.world_from_portrait
    settings.photo, settings.verdict = asked["photo"], "unreliable: hardly a face"
    settings.advice = "one line\nand another"
    bpy.ops.world_from_portrait.estimate()
    panels, running, wording = module("panels"), module("running"), module("wording")

    def draw(self: bpy.types.Panel, context: bpy.types.Context) -> None:
        said = [wording.UNKNOWN, *wording.VERDICTS.values()]
        try:
            for panel in (panels.Sidebar, panels.OfWorld):
                panel.draw(self, context)
            running.stop()
            running.message = "what is wrong, and what to do about it, at some length " * 3
            for panel in (panels.Sidebar, panels.OfWorld):
                panel.draw(self, context)
            for icon, sentence in said:
                self.layout.label(text=sentence, icon=icon)
            print("FOUND", json.dumps("drawn"), flush=True)
        except BaseException:
            traceback.print_exc()
        finally:
            running.stop()
            os._exit(0)

    panel = type("VIEW3D_PT_drawn", (bpy.types.Panel,), {
        "bl_label": "Drawn", "bl_space_type": "VIEW_3D", "bl_region_type": "UI", "draw": draw,
    })  # fmt: skip
    bpy.utils.register_class(panel)
    (window,) = bpy.context.window_manager.windows
    (area,) = [area for area in window.screen.areas if area.type == "VIEW_3D"]
    (region,) = [region for region in area.regions if region.type == "UI"]
    with bpy.context.temp_override(window=window, screen=window.screen, area=area, region=region):
        bpy.ops.wm.call_panel("EXEC_DEFAULT", name="VIEW3D_PT_drawn", keep_open=False)


CHECKS = {
    each.__name__: each
    for each in (
        set_up, irradiance, head_rendered, colours, views, older, refusals, without_cycles,
        broken_off, again, undo, runs, pictures, left_behind, drawn,
    )
}  # fmt: skip

if __name__ == "__main__":
    main()
