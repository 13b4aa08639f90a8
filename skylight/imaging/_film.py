"""Films: decoded as they play, upright, each frame with its time; HDR films are recognised.

Which curve a film's codes follow is told by the boxes of an MP4 or QuickTime file (ISO/IEC
14496-12, 4.2: a length, a name of four letters and a content): a track's sample description may
hold ``colr`` (12.1.5), whose second code point is the transfer characteristic (ITU-T H.273, table
3). Where there is none, the sequence parameter set of the coded video tells it (HEVC: ITU-T H.265,
7.3.2.2 and E.2.1). Files of other kinds have no such boxes.
"""

import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import cv2
import numpy as np
from jaxtyping import UInt8

from skylight.errors import InputError
from skylight.io._bounded import PIXELS_MAX

# ITU-T H.273, table 3.
HDR_TRANSFERS = {16: "PQ (SMPTE ST 2084)", 18: "HLG (ARIB STD-B67)"}
_PARENTS = {b"moov", b"trak", b"mdia", b"minf", b"stbl"}
_ENTRY = 78  # bytes of a visual sample entry before its boxes (ISO/IEC 14496-12, 12.1.3)
_MOST = 2**20  # bytes of a sample description: real ones have some hundreds
_DEPTH_MOST = 8


def transfer_characteristic(path: Path) -> int | None:
    """H.273's number of a film's transfer characteristic; None where no box tells it.

    Of several video tracks the first counts. What is damaged is passed over: the decoder says what
    is wrong with it.
    """
    with path.open("rb") as file:
        for content in _sample_descriptions(file, 0, os.fstat(file.fileno()).st_size):
            for entry in _boxes(content, 8):  # after version and count
                inner = dict(_boxes(entry[1], _ENTRY))
                colour = inner.get(b"colr", b"")
                if colour[:4] in (b"nclx", b"nclc") and len(colour) >= 8:
                    return int.from_bytes(colour[6:8], "big")
                if b"hvcC" in inner and (told := _hevc_transfer(inner[b"hvcC"])) is not None:
                    return told
    return None


def _sample_descriptions(file: BinaryIO, start: int, end: int, depth: int = 0) -> Iterator[bytes]:
    """The content of each ``stsd`` box, without reading the pictures between."""
    while start + 8 <= end and depth <= _DEPTH_MOST:
        file.seek(start)
        head = file.read(16)
        length, name, offset = int.from_bytes(head[:4], "big"), head[4:8], 8
        if length == 1:
            length, offset = int.from_bytes(head[8:16], "big"), 16
        elif length == 0:  # to the end of the file
            length = end - start
        if length < offset or start + offset > end:
            return
        inside = start + offset, min(start + length, end)
        if name in _PARENTS:
            yield from _sample_descriptions(file, *inside, depth + 1)
        elif name == b"stsd" and length < _MOST:
            file.seek(inside[0])
            yield file.read(inside[1] - inside[0])
        start += length


def _boxes(content: bytes, start: int) -> Iterator[tuple[bytes, bytes]]:
    while start + 8 <= len(content):
        length = int.from_bytes(content[start : start + 4], "big")
        if length < 8:
            return
        yield content[start + 4 : start + 8], content[start + 8 : start + length]
        start += length


def _hevc_transfer(configuration: bytes) -> int | None:
    """That of the sequence parameter set in an ``hvcC`` box (ISO/IEC 14496-15, 8.3.3.1)."""
    place = 23
    for _ in range(configuration[22] if len(configuration) > 22 else 0):
        kind = configuration[place] & 63 if place < len(configuration) else 0
        count = int.from_bytes(configuration[place + 1 : place + 3], "big")
        place += 3
        for _ in range(count):
            if place >= len(configuration):
                return None
            length = int.from_bytes(configuration[place : place + 2], "big")
            unit = configuration[place + 2 : place + 2 + length]
            place += 2 + length
            if kind == 33:
                try:
                    return _transfer_of_sps(_Bits(unit[2:]))
                except IndexError:  # cut short
                    return None
    return None


class _Bits:
    """Bits of a payload, without the bytes that keep start codes out (H.265, 7.3.1.1)."""

    def __init__(self, payload: bytes) -> None:
        clean = payload.replace(b"\0\0\3", b"\0\0")
        self._bits = "".join(f"{byte:08b}" for byte in clean)
        self._place = 0

    def u(self, count: int) -> int:
        end = self._place + count
        if end > len(self._bits):
            raise IndexError
        value = int(self._bits[self._place : end] or "0", 2)
        self._place = end
        return value

    def ue(self) -> int:
        """Exp-Golomb (H.265, 9.2)."""
        zeros = 0
        while not self.u(1):
            zeros += 1
        return (1 << zeros) - 1 + self.u(zeros)

    def skip(self, count: int) -> None:
        for _ in range(count):
            self.ue()


def _transfer_of_sps(bits: _Bits) -> int | None:
    """H.265, 7.3.2.2, up to the colour description of E.2.1; None where that is left out."""
    bits.u(4)
    layers = bits.u(3)
    bits.u(1)
    _skip_profile(bits, layers)
    bits.ue()
    if bits.ue() == 3:  # 4:4:4
        bits.u(1)
    bits.skip(2)
    if bits.u(1):  # conformance window
        bits.skip(4)
    bits.skip(2)
    order_bits = bits.ue() + 4
    for _ in range(layers + 1 if bits.u(1) else 1):
        bits.skip(3)
    bits.skip(6)
    if bits.u(1) and bits.u(1):
        _skip_scaling_lists(bits)
    bits.u(2)
    if bits.u(1):  # PCM
        bits.u(8)
        bits.skip(2)
        bits.u(1)
    _skip_reference_sets(bits)
    if bits.u(1):
        for _ in range(bits.ue()):
            bits.u(order_bits + 1)
    bits.u(2)
    if not bits.u(1):  # no video usability information
        return None
    if bits.u(1) and bits.u(8) == 255:
        bits.u(32)
    if bits.u(1):
        bits.u(1)
    if bits.u(1):
        bits.u(4)
        if bits.u(1):
            bits.u(8)
            return bits.u(8)
    return None


def _skip_profile(bits: _Bits, layers: int) -> None:
    bits.u(96)
    present = [(bits.u(1), bits.u(1)) for _ in range(layers)]
    if layers:
        bits.u(2 * (8 - layers))
    for profile, level in present:
        bits.u(88 * profile + 8 * level)


def _skip_scaling_lists(bits: _Bits) -> None:
    for size in range(4):
        for _ in range(2 if size == 3 else 6):
            if not bits.u(1):
                bits.ue()
            else:
                bits.skip((size > 1) + min(64, 16 << (2 * size)))


def _skip_reference_sets(bits: _Bits) -> None:
    """The short-term ones (H.265, 7.3.7)."""
    pictures = 0
    for number in range(bits.ue()):
        if number and bits.u(1):  # told by what changes against the one before
            bits.u(1)
            bits.ue()
            used = 0
            for _ in range(pictures + 1):
                used += 1 if bits.u(1) else bits.u(1)
            pictures = used
        else:
            before, after = bits.ue(), bits.ue()
            pictures = before + after
            for _ in range(pictures):
                bits.ue()
                bits.u(1)


FILM_SUFFIXES = frozenset({".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm"})
USUAL_RATE = 30.0  # frames a second, where a file does not tell
# what FFmpeg prints of a damaged film says less than our message
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")


@dataclass(frozen=True, kw_only=True)
class FilmFrame:
    """``codes`` (h,w,3), upright RGB of 8 bits, that are shown at ``time_s``.

    ``number`` counts the frames of the film from 0.
    """

    number: int
    time_s: float
    codes: UInt8[np.ndarray, "h w 3"]


@contextmanager
def opened_film(source: Path | int) -> Iterator[cv2.VideoCapture]:
    """A film, or the webcam of that number, as OpenCV reads it; turned as the file asks."""
    name = f"webcam {source}" if isinstance(source, int) else str(source)
    require_film(source)
    if isinstance(source, Path):
        transfer = HDR_TRANSFERS.get(transfer_characteristic(source) or 0)
        if transfer is not None:
            raise InputError(
                f"{source}: its codes are high dynamic range, {transfer}, which is not read; "
                "export it as SDR (Rec.709)"
            )
    # what OpenCV prints of a failure says less than our message
    log = cv2.utils.logging
    level = log.setLogLevel(log.LOG_LEVEL_SILENT)
    if isinstance(source, int):
        capture = cv2.VideoCapture(source)
    else:  # no other decoder of OpenCV's, which takes "film01.mp4" for a picture of many
        capture = cv2.VideoCapture(str(source), cv2.CAP_FFMPEG)
    log.setLogLevel(level)
    try:
        if not capture.isOpened():
            live = isinstance(source, int)
            mend = "see that it is plugged in and free" if live else "give a video such as .mp4"
            raise InputError(f"cannot open {name}: {mend}, or photographs")
        capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 1)
        width = int(capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        height = int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        if width * height > PIXELS_MAX:
            raise InputError(f"{name}: {width}x{height} pixels are too many; scale it down")
        yield capture
    finally:
        capture.release()


def require_film(source: Path | int) -> None:
    """Refuse a video's file that is not there, and webcams below 0."""
    if isinstance(source, int):
        if source < 0:
            raise InputError(f"webcams are numbered from 0, got {source}")
    elif not source.is_file():
        raise InputError(f"cannot read {source}: there is no such file; give a video")


def film_rate(source: Path | int) -> float:
    """Frames a second that a video says it has; 30 where it does not, and for webcams."""
    if isinstance(source, int):
        return USUAL_RATE
    with opened_film(source) as capture:
        return _rate(capture)


def _rate(capture: cv2.VideoCapture) -> float:
    rate = float(capture.get(cv2.CAP_PROP_FPS))
    return rate if 1 <= rate <= 480 else USUAL_RATE


def told_length_s(source: Path) -> float | None:
    """How long a film's header says it is; None where it does not."""
    with opened_film(source) as capture:
        count = float(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        rate = float(capture.get(cv2.CAP_PROP_FPS))
    told = math.isfinite(count) and count > 0 and math.isfinite(rate) and rate > 0
    return count / rate if told else None


def film_frames(
    source: Path, *, most_a_second: float = math.inf, most_side: int | None = None
) -> Iterator[FilmFrame]:
    """The frames of a film as they play, of which ``most_a_second`` are given at most.

    Larger ones are scaled to ``most_side`` pixels on their longer side. Times are those at which
    frames are shown, whatever the rate is, from 0 on and never backwards.
    One frame is held at a time.

    Raises
    ------
    InputError
        As :func:`opened_film`, or no frame can be decoded.
    """
    with opened_film(source) as capture:
        step_s = 1 / _rate(capture)
        period_s = 1 / most_a_second
        number, first_s, last_s, due_s = 0, 0.0, -step_s, 0.0
        while capture.grab():
            shown_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
            first_s = shown_s if number == 0 else first_s
            # files without times: one step after the frame before
            time_s = shown_s - first_s
            last_s = time_s if number == 0 or time_s > last_s else last_s + step_s
            # half a step early is on time, so that rates which do not divide the film's are kept
            if last_s >= due_s - step_s / 2:
                good, bgr = capture.retrieve()
                if not good:
                    break
                due_s = due_s + period_s if due_s + period_s > last_s else last_s + period_s
                yield FilmFrame(
                    number=number, time_s=max(last_s, 0.0), codes=_scaled(as_rgb(bgr), most_side)
                )
            number += 1
        if number == 0:
            raise InputError(f"{source}: it holds no pictures; record it again")


def _scaled(
    codes: UInt8[np.ndarray, "h w 3"], most_side: int | None
) -> UInt8[np.ndarray, "h2 w2 3"]:
    height, width = codes.shape[:2]
    scale = 1.0 if most_side is None else most_side / max(height, width)
    if scale >= 1:
        return codes
    size = max(1, round(width * scale)), max(1, round(height * scale))
    return np.asarray(cv2.resize(codes, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def as_rgb(picture: np.ndarray) -> UInt8[np.ndarray, "h w 3"]:
    """What OpenCV decoded, grey or BGR, as RGB."""
    code = cv2.COLOR_GRAY2RGB if picture.ndim == 2 else cv2.COLOR_BGR2RGB
    return np.asarray(cv2.cvtColor(picture, code), dtype=np.uint8)
