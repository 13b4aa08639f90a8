# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's classes, properties and handlers, made known and taken back."""

import bpy

from . import operators, panels, running
from .commands import (
    KEYS,
    LIGHTS,
    MOST_STRENGTH,
    SIZES_DEG,
    USUAL_DEG,
    USUAL_STRENGTH,
)
from .scene_setup import light_as_white


class WorldFromPortraitAsked(bpy.types.PropertyGroup):
    """A scene's: what was asked for, and what skylight said of the light that it is set up with."""

    photo: bpy.props.StringProperty(
        name="Photo", description="Picture of a face", subtype="FILE_PATH"
    )
    light: bpy.props.EnumProperty(
        name="Light", description="What light may look like", items=LIGHTS
    )
    folder: bpy.props.StringProperty(
        name="Results",
        description="Folder for what skylight finds; by default beside the photo, with _light",
        subtype="DIR_PATH",
    )
    white: bpy.props.FloatVectorProperty(
        name="White",
        description="What white paint that faces the camera looks like in this light. Pick a wall, "
        "paper or shirt in the photo that is white, and the light takes its brightness and colour",
        subtype="COLOR",
        min=0.0,
        update=light_as_white,
    )
    white_found: bpy.props.FloatVectorProperty()
    estimate: bpy.props.StringProperty(subtype="DIR_PATH")  # that the scene is set up from
    key: bpy.props.EnumProperty(name="Key", description="Where the key light is", items=KEYS)
    size_deg: bpy.props.FloatProperty(
        name="Softness",
        description="Width of the key light in degrees: 5 is a bare bulb, 40 a softbox nearby",
        min=SIZES_DEG[0],
        max=SIZES_DEG[1],
        default=USUAL_DEG,
        precision=0,
    )
    strength: bpy.props.FloatProperty(
        name="Strength",
        description="How many times as bright as the fill the key light is; 0 leaves the fill",
        min=0.0,
        soft_max=8.0,
        max=MOST_STRENGTH,
        default=USUAL_STRENGTH,
    )
    verdict: bpy.props.StringProperty()
    advice: bpy.props.StringProperty()


class WorldFromPortraitPreferences(bpy.types.AddonPreferences):
    """Where skylight is."""

    bl_idname = __package__

    program: bpy.props.StringProperty(
        name="skylight",
        description="The program; by default the one that is found on PATH",
        subtype="FILE_PATH",
    )

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.prop(self, "program")


CLASSES = (
    WorldFromPortraitAsked,
    WorldFromPortraitPreferences,
    *operators.CLASSES,
    *panels.CLASSES,
)


@bpy.app.handlers.persistent
def end_run(*_: object) -> None:
    """Another file is opened, without the scene that the run is for."""
    running.stop()


def register() -> None:
    """Make all known to Blender."""
    for each in CLASSES:
        bpy.utils.register_class(each)
    bpy.types.Scene.world_from_portrait = bpy.props.PointerProperty(type=WorldFromPortraitAsked)
    bpy.app.handlers.load_pre.append(end_run)


def unregister() -> None:
    """Take all back, and end what runs."""
    running.stop()
    bpy.app.handlers.load_pre.remove(end_run)
    del bpy.types.Scene.world_from_portrait
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)
