"""Films: .mp4, .avi, .mkv and .webm, told apart by how they begin; FFmpeg, by OpenCV, decodes.

A picture takes FFmpeg longer than opening the film, so three are read.
"""

from itertools import islice

import cv2
import numpy as np

from skylight.imaging._film import film_frames, told_length_s
from tests.films import with_quarter_turn
from tests.fuzz.files import PLACE, as_file

_CODED = {".mp4": "mp4v", ".avi": "MJPG", ".mkv": "FFV1", ".webm": "VP80"}
_BEGINNINGS = {b"RIFF": ".avi", b"\x1aE\xdf\xa3": ".mkv"}


def seeds() -> list[bytes]:
    made = []
    for suffix, codec in _CODED.items():
        path = PLACE / f"a{suffix}"
        writer = cv2.VideoWriter(
            str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*codec), 10.0, (32, 32)
        )
        for shade in (60, 120, 180):
            writer.write(np.full((32, 32, 3), shade, np.uint8))
        writer.release()
        if path.exists() and path.stat().st_size:  # not every build has all encoders
            made.append(path.read_bytes())
    with_quarter_turn(PLACE / "a.mp4")
    return [*made, (PLACE / "a.mp4").read_bytes()]


def read(content: bytes) -> None:
    suffix = _BEGINNINGS.get(content[:4], ".mp4")
    path = as_file(content, f"film{suffix}")
    length = told_length_s(path)
    assert length is None or length > 0
    times = [-1.0]
    for frame in islice(film_frames(path, most_side=64), 3):
        assert max(frame.codes.shape) <= 64
        assert frame.time_s >= times[-1]
        times.append(frame.time_s)
