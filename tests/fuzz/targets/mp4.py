"""What the boxes of an MP4 or QuickTime film tell of its codes, before a decoder sees it."""

import numpy as np

from skylight.imaging._film_headers import film_header
from tests.films import box, with_in_description, write_film
from tests.fuzz.files import PLACE, as_file
from tests.imaging.test_film import sequence_parameters


def seeds() -> list[bytes]:
    units = sequence_parameters(16, layers=1, lists=True)
    array = bytes([33, 0, 1]) + len(units).to_bytes(2, "big") + units
    told = [
        b"",
        box(b"colr", b"nclx" + bytes([0, 9, 0, 16, 0, 9, 0])),
        box(b"hvcC", bytes(22) + b"\1" + array),
    ]
    films = []
    for extra in told:
        film = write_film(PLACE / "a.mp4", [np.zeros((16, 16, 3), np.uint8)] * 2)
        with_in_description(film, extra)
        films.append(film.read_bytes())
    return films


def read(content: bytes) -> None:
    told = film_header(as_file(content, "film.mp4")).transfer
    assert told is None or told >= 0
