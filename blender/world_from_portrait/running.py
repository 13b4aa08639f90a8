# SPDX-License-Identifier: GPL-3.0-or-later
"""The run of skylight that goes on, if any, and what the panel says of the last one.

A timer watches it rather than a modal operator, which would keep Blender from saving automatically.
"""

from collections.abc import Callable
from dataclasses import dataclass

import bpy

from .run import Run, Step

INTERVAL_S = 0.2


@dataclass
class Watched:
    """A run for a scene (by name, since undo may replace it); ``then`` does what comes after."""

    run: Run
    scene: str
    then: Callable[[Run], None]


current: Watched | None = None
message = ""  # why there is no scene, or what to take care of


def start(steps: list[Step], scene: bpy.types.Scene, then: Callable[[Run], None]) -> None:
    """Run the steps, then call ``then`` with the run, while the scene is that of the context."""
    global current
    tell("")
    current = Watched(Run(steps), scene.name, then)
    bpy.app.timers.register(tick, first_interval=INTERVAL_S)


def stop() -> None:
    """End what runs at once."""
    global current
    if current is not None:
        current.run.kill()
        current = None
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)


def tick() -> float | None:
    """Called by the timer; None ends it."""
    global current
    if current is None:
        return None
    state = current.run.poll()
    if state == "done" and _is_busy():
        current.run.stage = "done: leave Edit Mode, or wait for the render"
    if state == "running" or (state == "done" and _is_busy()):
        _redraw()
        return INTERVAL_S
    ended, current = current, None
    if state == "done":
        _finish(ended)
    else:
        tell("Cancelled." if state == "cancelled" else ended.run.error)
    return None


def tell(line: str) -> None:
    """Say a line in the panel."""
    global message
    message = line
    _redraw()


def _is_busy() -> bool:
    """Whether the scene must not be changed now: undo steps of edit modes know their mesh alone."""
    return bpy.context.mode != "OBJECT" or bpy.app.is_job_running("RENDER")


def _finish(ended: Watched) -> None:
    scene = bpy.data.scenes.get(ended.scene)
    if scene is None:
        tell(f'The scene "{ended.scene}" is not there any more: estimate again')
        return
    try:
        with bpy.context.temp_override(scene=scene):
            ended.then(ended.run)
    except RuntimeError:  # reported, and told by the operator
        pass


def _redraw() -> None:
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in ("VIEW_3D", "PROPERTIES", "IMAGE_EDITOR"):
                area.tag_redraw()
