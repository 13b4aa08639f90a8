"""Messages of errors quote files' texts and names; a terminal gets one line of them."""

import pytest

from blender.world_from_portrait.run import Failure
from skylight.errors import InputError


@pytest.mark.parametrize("kind", [InputError, Failure])
def test_what_cannot_be_printed_is_left_out(kind: type[Exception]) -> None:
    assert str(kind("a\nb\x1b[2Jc\udcffd é 光")) == "a b [2Jc d é 光"
