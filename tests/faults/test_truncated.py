"""Files that end early, at every sixteenth of their length: refused, in every format that can know.

Text without a count or an end (.obj, tables, YAML) may end early and still be whole; what is read
of it then is what it says. Of described tensors (tests/fuzz/tensor_files.py) what is missing is 0.
"""

from importlib import import_module

import pytest

from skylight.errors import SkylightError
from tests.fuzz.files import clear

pytestmark = pytest.mark.slow

ENDLESS = (b"v ", b"# http", b"file,", b"kind:", b'{"texts"')
TARGETS = ("exr", "hdr", "photo", "raw", "code", "records", "vox", "npz", "mesh", "tensors")


@pytest.mark.parametrize("name", TARGETS)
def test_it_is_refused(name: str) -> None:
    target = import_module(f"tests.fuzz.targets.{name}")
    for seed in target.seeds():
        target.read(seed)
        for sixteenth in range(16):
            part = seed[: len(seed) * sixteenth // 16]
            try:
                target.read(part)
            except SkylightError as error:
                clear(error)
            else:
                assert seed.startswith(ENDLESS), (seed[:40], sixteenth)
