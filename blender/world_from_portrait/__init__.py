# SPDX-License-Identifier: GPL-3.0-or-later
"""World from Portrait: a scene lit as a face in a photograph was, by the program skylight.

Blender's side alone: skylight runs in a process of its own and leaves files. What needs no Blender
(``commands``, ``run``, ``scene_file``, ``wording``) does not import bpy, so this module does so
only once the extension is switched on.
"""


def register() -> None:
    """Switch the extension on."""
    from . import registration

    registration.register()


def unregister() -> None:
    """Switch it off; what still runs is ended."""
    from . import registration

    registration.unregister()
