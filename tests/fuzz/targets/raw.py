"""Cameras' RAW files, which LibRaw develops: DNG, and whatever a content claims to be."""

from skylight.imaging._photo import read_photo
from tests.fuzz.files import as_file, written
from tests.imaging.test_raw import mosaic, write_dng

_SMALL = mosaic()[:32, :32]


def seeds() -> list[bytes]:
    return [
        written("a.dng", lambda path: write_dng(path, _SMALL)),
        written("b.dng", lambda path: write_dng(path, _SMALL, orientation=6, rate=100)),
    ]


def read(content: bytes) -> None:
    photo = read_photo(as_file(content, "photo.dng"))
    assert bool(photo.pixels.isfinite().all())
    assert photo.clipped.shape == photo.pixels.shape[:2]
