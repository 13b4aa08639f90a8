"""Trace the evaluation scenes that come with skylight: python tools/build_scenes.py"""

import os

from skylight._figures import SCENE_GRID, SCENE_HEIGHT
from skylight.transport._scene import trace_scene

SIZES = ((72, 64), (SCENE_HEIGHT, SCENE_GRID))  # of scores and of reports


def main() -> None:
    for height, grid_height in SIZES:
        traced = trace_scene(height, grid_height, workers=os.cpu_count() or 1)
        traced.path.parent.mkdir(exist_ok=True)
        traced.save(traced.path)
        print(f"{traced.path.name}: {traced.path.stat().st_size:,} bytes")


if __name__ == "__main__":
    main()
