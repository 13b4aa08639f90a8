"""The choices of requests, read by a server that does not import torch."""

import subprocess
import sys
from importlib.resources import files
from typing import get_args

from skylight._names import LIGHT_NAMES, PLACES as NAMED_PLACES
from skylight.csc._dictionary import BuiltinName
from skylight.studio._requests import (
    DICTIONARIES,
    LIGHTS,
    PLACES,
    VoxelRequest,
)
from skylight.studio.tasks._probes import STARS
from tests.studio.conftest import PATIENCE_S


def test_choices_are_those_of_the_package() -> None:
    assert tuple(LIGHTS) == LIGHT_NAMES
    assert tuple(PLACES) == NAMED_PLACES
    assert set(DICTIONARIES) == set(get_args(BuiltinName))
    assert get_args(VoxelRequest.__annotations__["probe"]) == tuple(STARS)


def test_the_server_itself_needs_no_torch() -> None:
    shipped = files("skylight.models") / "data" / "sky_autoencoder"
    code = (
        "import sys, pathlib, skylight.studio._server as server\n"
        f"server.read_manifest(pathlib.Path({str(shipped)!r}))\n"
        "sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], timeout=PATIENCE_S).returncode == 0
