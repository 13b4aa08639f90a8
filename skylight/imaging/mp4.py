"""How a film's codes encode light, as the boxes of an MP4 or QuickTime file say.

Boxes (ISO/IEC 14496-12, 4.2) are a length, a name of four letters and a content; a track's sample
description may hold ``colr`` (12.1.5), whose second code point is the transfer characteristic
(ITU-T H.273, table 3). Where there is none, the sequence parameter set of the coded video tells it
(HEVC: ITU-T H.265, 7.3.2.2 and E.2.1). Files of other kinds have no such boxes.
"""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

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
