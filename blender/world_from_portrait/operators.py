# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panel's buttons do."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import ClassVar

import bpy

from . import running
from .commands import (
    EXPORTED,
    estimate_steps,
    export_steps,
    find_skylight,
    relight_steps,
    relit_picture,
)
from .run import Failure, Run
from .scene_file import read_scene
from .scene_setup import set_up


class Starting:
    """Starts a run of skylight, unless one goes on; what is wrong is told in the panel too."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        cls.poll_message_set("skylight is running")
        return running.current is None

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            program = find_skylight(context.preferences.addons[__package__].preferences.program)
            self.begin(context.scene, program)
        except Failure as failure:
            running.tell(str(failure))
            self.report({"ERROR"}, str(failure))
            return {"CANCELLED"}
        return {"FINISHED"}


class Estimate(Starting, bpy.types.Operator):
    """Find the light of the photograph with skylight, and set the scene up with it"""

    bl_idname = "world_from_portrait.estimate"
    bl_label = "Set Up from Photo"

    def begin(self, scene: bpy.types.Scene, program: str) -> None:
        asked = scene.world_from_portrait
        if not asked.photo:
            raise Failure("Choose a photo first")
        photo = Path(bpy.path.abspath(asked.photo))
        if not photo.is_file():
            raise Failure(f"{photo}: there is no such photo")
        chosen = Path(bpy.path.abspath(asked.folder)) if asked.folder else None
        folder = chosen or photo.with_name(f"{photo.stem}_light")
        steps = estimate_steps(program, photo, folder, asked.light)
        running.start(steps, scene, _then_set_up(folder))


class OpenEstimate(Starting, bpy.types.Operator):
    """Set the scene up from the folder of an estimate that skylight made before"""

    bl_idname = "world_from_portrait.open_estimate"
    bl_label = "Set Up from Estimate"

    directory: bpy.props.StringProperty(subtype="DIR_PATH")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def begin(self, scene: bpy.types.Scene, program: str) -> None:
        folder = Path(bpy.path.abspath(self.directory))
        if not (folder / "estimate.json").is_file():
            raise Failure(f"{folder}: not the folder of an estimate: estimate.json is not there")
        running.start(export_steps(program, folder), scene, _then_set_up(folder))


class Relight(Starting, bpy.types.Operator):
    """Show the photographed person under a key light, as a picture in the Image Editor"""

    bl_idname = "world_from_portrait.relight"
    bl_label = "Relight Portrait"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not context.scene.world_from_portrait.estimate:
            cls.poll_message_set("Set the scene up from a photo or an estimate first")
            return False
        return super().poll(context)

    def begin(self, scene: bpy.types.Scene, program: str) -> None:
        asked = scene.world_from_portrait
        folder = Path(bpy.path.abspath(asked.estimate))
        if not (folder / "estimate.json").is_file():
            raise Failure(f"{folder}: the estimate is not there any more: set up from it again")
        steps = relight_steps(
            program, folder, asked.key, size_deg=asked.size_deg, strength=asked.strength
        )
        running.start(steps, scene, partial(_show, relit_picture(folder, asked.key)))


class Cancel(bpy.types.Operator):
    """End skylight; the scene stays as it is"""

    bl_idname = "world_from_portrait.cancel"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return running.current is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        if running.current is not None:
            running.current.run.cancel()
        return {"FINISHED"}


class SetUp(bpy.types.Operator):
    """Set the scene up from a folder that 'skylight export blender' wrote"""

    bl_idname = "world_from_portrait.set_up"
    bl_label = "World from Portrait"
    bl_options: ClassVar = {"UNDO", "INTERNAL"}

    folder: bpy.props.StringProperty(subtype="DIR_PATH")

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            set_up(context.scene, read_scene(Path(bpy.path.abspath(self.folder))))
        except Failure as failure:
            running.tell(str(failure))
            self.report({"ERROR"}, str(failure))
            return {"CANCELLED"}
        running.tell("")
        return {"FINISHED"}


def _then_set_up(estimate: Path) -> Callable[[Run], None]:
    """Set the scene of the context up from an estimate that was exported."""

    def then(run: Run) -> None:
        # True: a step of undo, which operators called from Python do not make otherwise
        bpy.ops.world_from_portrait.set_up("EXEC_DEFAULT", True, folder=str(estimate / EXPORTED))

    return then


def _show(picture: Path, run: Run) -> None:
    """In the Image Editors there are, or a line says where it is; with what to take care of."""
    try:
        image = bpy.data.images.load(str(picture), check_existing=True)
        image.reload()  # an earlier one by this name was written over
        is_read = 0 not in image.size  # it is decoded when its size is asked for
    except RuntimeError:
        is_read = False
    if not is_read:
        running.tell(f"{picture}: Blender cannot read it: relight the portrait again")
        return
    windows = bpy.context.window_manager.windows
    editors = [a for w in windows for a in w.screen.areas if a.type == "IMAGE_EDITOR"]
    for editor in editors:
        editor.spaces.active.image = image
    where = [] if editors else [f"{image.name} is there: choose it in an Image Editor"]
    running.tell(". ".join([*where, *run.doubts]))


CLASSES = Estimate, OpenEstimate, Relight, Cancel, SetUp
