# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel, in the 3D viewport's sidebar and among the world's properties."""

import textwrap
from typing import Any, ClassVar

import bpy

from . import running
from .operators import Cancel, Estimate, OpenEstimate, Relight
from .scene_setup import shows_as_photographed, takes_white
from .wording import of_verdict

LETTER_PX = 7  # about, of Blender's own font at a scale of 1


class Drawn:
    """What both panels show."""

    bl_label = "World from Portrait"
    layout: Any

    def draw(self, context: bpy.types.Context) -> None:
        layout, asked = self.layout, context.scene.world_from_portrait
        scale = context.preferences.system.ui_scale or 1.0  # 0 without a window
        columns = max(20, int(context.region.width / (LETTER_PX * scale)) - 6)
        choices = layout.column()
        choices.enabled = running.current is None
        for name in ("photo", "light", "folder"):
            choices.prop(asked, name)
        if running.current is not None:
            run = running.current.run
            layout.progress(factor=run.share, text=run.stage)
            layout.operator(Cancel.bl_idname, icon="CANCEL")
        else:
            layout.operator(Estimate.bl_idname, icon="LIGHT_SUN")
            layout.operator(OpenEstimate.bl_idname, icon="FILE_FOLDER")
        if running.message:
            _lines(layout.box(), running.message, "ERROR", columns)
        if asked.verdict:
            icon, sentence = of_verdict(asked.verdict)
            box = layout.box()
            _lines(box, asked.verdict.capitalize(), icon, columns)
            for line in (sentence, *asked.advice.split("\n")):
                _lines(box, line, "NONE", columns)
            _colours(layout.box(), context.scene, columns)
            _relighting(layout.box(), asked)


def _colours(layout: Any, scene: bpy.types.Scene, columns: int) -> None:
    """What white looks like, and whether colours are shown as the photograph's are."""
    if takes_white(scene):
        layout.prop(scene.world_from_portrait, "white")
    else:
        line = "White: this scene was set up by an older extension: set it up again."
        _lines(layout, line, "INFO", columns)
    if shows_as_photographed(scene):
        _lines(layout, "Shown as the photo is: view Standard, exposure 0.", "COLOR", columns)
    else:
        line = (
            "Not the photo's colours: set display sRGB, view Standard, look None, exposure 0, "
            "gamma 1, no curves, no white balance."
        )
        _lines(layout, line, "ERROR", columns)


def _relighting(layout: Any, asked: Any) -> None:
    """The person of the photograph in another light, as a picture."""
    for name in ("key", "size_deg", "strength"):
        layout.prop(asked, name)
    layout.operator(Relight.bl_idname, icon="LIGHT_AREA")


class Sidebar(Drawn, bpy.types.Panel):
    """In the 3D viewport."""

    bl_idname = "VIEW3D_PT_world_from_portrait"
    bl_space_type, bl_region_type = "VIEW_3D", "UI"
    bl_category = "Portrait"


class OfWorld(Drawn, bpy.types.Panel):
    """Among the world's properties."""

    bl_idname = "WORLD_PT_world_from_portrait"
    bl_space_type, bl_region_type = "PROPERTIES", "WINDOW"
    bl_context = "world"
    bl_options: ClassVar = {"DEFAULT_CLOSED"}


def _lines(layout: Any, text: str, icon: str, columns: int) -> None:
    """A line for people, wrapped, since labels are cut off where the panel ends."""
    column = layout.column(align=True)
    for number, line in enumerate(textwrap.wrap(text, columns)):
        column.label(text=line, icon=icon if number == 0 else "NONE")


CLASSES = Sidebar, OfWorld
