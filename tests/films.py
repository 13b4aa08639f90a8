"""Small films, and boxes of MP4 files that say what a writer does not."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

PARENTS = (b"moov", b"trak", b"mdia", b"minf", b"stbl")


def write_film(path: Path, frames: Sequence[np.ndarray], *, rate: float = 10.0) -> Path:
    """RGB frames of one size as an MPEG-4 film."""
    height, width = frames[0].shape[:2]
    code = cv2.VideoWriter.fourcc(*"mp4v")
    made = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, rate, (width, height))
    for frame in frames:
        made.write(np.ascontiguousarray(frame[..., ::-1]))
    made.release()
    return path


def box(name: bytes, content: bytes) -> bytes:
    return (8 + len(content)).to_bytes(4, "big") + name + content


def with_box_replaced(data: bytes, path: Sequence[bytes], content: bytes) -> bytes:
    """The file with another content of the box at ``path``; the sizes around it follow."""
    start, out = 0, b""
    while start + 8 <= len(data):
        length, name = int.from_bytes(data[start : start + 4], "big"), data[start + 4 : start + 8]
        inside = data[start + 8 : start + length]
        if name == path[0]:
            inside = content if len(path) == 1 else with_box_replaced(inside, path[1:], content)
        out, start = out + box(name, inside), start + length
    return out


def content_of(data: bytes, path: Sequence[bytes]) -> bytes:
    start = 0
    while start + 8 <= len(data):
        length, name = int.from_bytes(data[start : start + 4], "big"), data[start + 4 : start + 8]
        inside = data[start + 8 : start + length]
        if name == path[0]:
            return inside if len(path) == 1 else content_of(inside, path[1:])
        start += length
    raise KeyError(path)


def with_in_description(film: Path, extra: bytes) -> None:
    """Append boxes to the (one) sample entry of a film."""
    where = (*PARENTS, b"stsd")
    data = film.read_bytes()
    described = content_of(data, where)
    size = int.from_bytes(described[8:12], "big") + len(extra)
    changed = described[:8] + size.to_bytes(4, "big") + described[12:] + extra
    film.write_bytes(with_box_replaced(data, where, changed))


def with_frame_times(film: Path, steps: Sequence[int]) -> None:
    """How many ticks each frame is shown (``stts``), in place of a constant rate."""
    entries = b"".join((1).to_bytes(4, "big") + step.to_bytes(4, "big") for step in steps)
    content = bytes(4) + len(steps).to_bytes(4, "big") + entries
    film.write_bytes(with_box_replaced(film.read_bytes(), (*PARENTS, b"stts"), content))


def ticks_a_second(film: Path) -> int:
    header = content_of(film.read_bytes(), (b"moov", b"trak", b"mdia", b"mdhd"))
    return int.from_bytes(header[12:16], "big")


def with_quarter_turn(film: Path) -> None:
    """The track header's matrix of a film that players turn clockwise by 90 degrees."""
    where = (b"moov", b"trak", b"tkhd")
    data = film.read_bytes()
    header = content_of(data, where)
    one, minus = (1 << 16).to_bytes(4, "big"), (-(1 << 16) & 0xFFFFFFFF).to_bytes(4, "big")
    zero, unit = bytes(4), (1 << 30).to_bytes(4, "big")
    matrix = zero + one + zero + minus + zero + zero + zero + zero + unit
    film.write_bytes(with_box_replaced(data, where, header[:40] + matrix + header[76:]))
