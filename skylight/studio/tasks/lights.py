"""The environment map of a job: an upload, or the result of an estimate."""

from pathlib import Path
from typing import TypedDict

from skylight.io.files import read_environment_map
from skylight.sphere.envmap import EnvironmentMap
from skylight.studio.tasks.uploads import named


class Light(TypedDict):
    """Where its file is, and what the user calls it."""

    path: str
    name: str


def read_light(light: Light) -> EnvironmentMap:
    """The map of the whole sphere."""
    path = Path(light["path"])
    with named(path, light["name"]):
        return read_environment_map(path)
