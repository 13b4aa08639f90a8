"""What a film's file tells of its pictures that the decoder does not: their curve, and fields.

Of an MP4 or QuickTime file boxes tell it (ISO/IEC 14496-12, 4.2: a length, a name of four letters
and a content): a track's sample description may hold ``colr`` (12.1.5), whose second code point is
the transfer characteristic (ITU-T H.273, table 3), and ``fiel``, the number of fields. Matroska has
elements for both. Where there are none, the sequence parameter set of the coded video tells them
(AVC: ITU-T H.264; HEVC: ITU-T H.265, 7.3.2.2 and E.2.1).
"""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

# ITU-T H.273, table 3.
HDR_TRANSFERS = {16: "PQ (SMPTE ST 2084)", 18: "HLG (ARIB STD-B67)"}
_PARENTS = {b"moov", b"trak", b"mdia", b"minf", b"stbl"}
_ENTRY = 78  # bytes of a visual sample entry before its boxes (ISO/IEC 14496-12, 12.1.3)
_MOST = 2**20  # bytes of a sample description: real ones have some hundreds
_DEPTH_MOST = 8
_EBML = b"\x1a\x45\xdf\xa3"
_TRACKS, _CLUSTER = 0x1654AE6B, 0x1F43B675
_TRACK, _KIND, _CODEC, _PRIVATE = 0xAE, 0x83, 0x86, 0x63A2
_FIELDS, _TRANSFER = 0x9A, 0x55BA
_MASTERS = {0x18538067, _TRACKS, _TRACK, 0xE0, 0x55B0}  # segment, tracks, track, video, colour
_TOLD = {_KIND, _CODEC, _PRIVATE, _FIELDS, _TRANSFER}
_HIGH_PROFILES = {44, 83, 86, 100, 110, 118, 122, 128, 134, 135, 138, 139, 244}


@dataclass(frozen=True)
class FilmHeader:
    """``transfer`` is H.273's number of the transfer characteristic; None where none is told.

    ``interlaced``: frames may be of two fields, taken one after the other; None: not told.
    """

    transfer: int | None = None
    interlaced: bool | None = None


def film_header(path: Path) -> FilmHeader:
    """What a film's file tells of its pictures; of several video tracks the first counts.

    What is damaged is passed over: the decoder says what is wrong with it.
    """
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        if file.read(4) == _EBML:
            return _matroska_header(file, size)
        for content in _sample_descriptions(file, 0, size):
            for _, entry in _boxes(content, 8):  # after version and count
                inner = dict(_boxes(entry, _ENTRY))
                colour, codec = inner.get(b"colr", b""), FilmHeader()
                if b"hvcC" in inner:
                    codec = _hevc_header(inner[b"hvcC"])
                elif b"avcC" in inner:
                    codec = _avc_header(inner[b"avcC"])
                elif len(inner.get(b"vpcC", b"")) > 8:
                    codec = FilmHeader(transfer=inner[b"vpcC"][8], interlaced=False)
                fields = {b"\1": False, b"\2": True}.get(inner.get(b"fiel", b"")[:1])
                told = codec.transfer
                if colour[:4] in (b"nclx", b"nclc") and len(colour) >= 8:
                    told = int.from_bytes(colour[6:8], "big")
                interlaced = fields or codec.interlaced if codec.interlaced is not None else fields
                if told is not None or interlaced is not None:
                    return FilmHeader(transfer=told, interlaced=interlaced)
    return FilmHeader()


def _matroska_header(file: BinaryIO, size: int) -> FilmHeader:
    """By the elements of RFC 9559: an identifier, a length and a content."""
    tracks: list[dict[int, bytes]] = [{}]
    for name, content in _elements(file, 0, size):
        if name == _TRACK:
            tracks.append({})
        tracks[-1].setdefault(name, content)
    track = next((track for track in tracks if track.get(_KIND) == b"\1"), {})
    told = FilmHeader()
    if track.get(_CODEC) == b"V_MPEGH/ISO/HEVC":
        told = _hevc_header(track.get(_PRIVATE, b""))
    elif track.get(_CODEC) == b"V_MPEG4/ISO/AVC":
        told = _avc_header(track.get(_PRIVATE, b""))
    elif track.get(_CODEC) in (b"V_VP8", b"V_VP9", b"V_AV1"):
        told = FilmHeader(interlaced=False)
    transfer = int.from_bytes(track.get(_TRANSFER, b"\2"), "big")
    return FilmHeader(
        transfer=told.transfer if transfer == 2 else transfer,  # 2: not specified
        interlaced=track.get(_FIELDS) == b"\1" or told.interlaced,
    )


def _elements(file: BinaryIO, start: int, end: int, depth: int = 0) -> Iterator[tuple[int, bytes]]:
    """Those of tracks, of all depths, in the order of the file."""
    while start < end and depth <= _DEPTH_MOST:
        file.seek(start)
        head = file.read(12)
        name_size = 9 - (head[0] if head else 0).bit_length()
        if name_size > 4 or len(head) <= name_size or not head[name_size]:
            return
        name = int.from_bytes(head[:name_size], "big")
        size = 9 - head[name_size].bit_length()
        length = int.from_bytes(head[name_size : name_size + size], "big") - (1 << (7 * size))
        start += name_size + size
        if length == (1 << (7 * size)) - 1:  # as long as what it lies in
            length = end - start
        if length < 0:  # cut short
            return
        if name in _MASTERS:
            if name == _TRACK:
                yield name, b""
            yield from _elements(file, start, min(start + length, end), depth + 1)
            if name == _TRACKS:
                return
        elif name == _CLUSTER:
            return
        elif length < _MOST and name in _TOLD:
            file.seek(start)
            yield name, file.read(length)
        start += length


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


def _hevc_header(configuration: bytes) -> FilmHeader:
    """Of the sequence parameter set in an ``hvcC`` box (ISO/IEC 14496-15, 8.3.3.1)."""
    place = 23
    for _ in range(configuration[22] if len(configuration) > 22 else 0):
        kind = configuration[place] & 63 if place < len(configuration) else 0
        count = int.from_bytes(configuration[place + 1 : place + 3], "big")
        place += 3
        for _ in range(count):
            if place >= len(configuration):
                return FilmHeader()
            length = int.from_bytes(configuration[place : place + 2], "big")
            unit = configuration[place + 2 : place + 2 + length]
            place += 2 + length
            if kind == 33:
                try:
                    return FilmHeader(
                        transfer=_transfer_of_sps(_Bits(unit[2:])),
                        # the profile's general_interlaced_source_flag (7.3.3)
                        interlaced=bool(unit[8] & 64),
                    )
                except IndexError:  # cut short
                    return FilmHeader()
    return FilmHeader()


def _avc_header(configuration: bytes) -> FilmHeader:
    """Of the sequence parameter set in an ``avcC`` box (ISO/IEC 14496-15, 5.3.3.1)."""
    length = int.from_bytes(configuration[6:8], "big")
    try:
        return _avc_sequence(_Bits(configuration[9 : 8 + length]))
    except IndexError:  # cut short
        return FilmHeader()


def _avc_sequence(bits: "_Bits") -> FilmHeader:
    """H.264, 7.3.2.1.1, up to the colour description of E.1.1."""
    profile = bits.u(8)
    bits.u(16)
    bits.ue()
    if profile in _HIGH_PROFILES:
        chroma = bits.ue()
        if chroma == 3:
            bits.u(1)
        bits.skip(2)
        bits.u(1)
        if bits.u(1):
            for number in range(12 if chroma == 3 else 8):
                if bits.u(1):
                    _skip_avc_scaling(bits, 16 if number < 6 else 64)
    bits.ue()
    order = bits.ue()
    if order == 0:
        bits.ue()
    elif order == 1:
        bits.u(1)
        bits.skip(2)
        bits.skip(bits.ue())
    bits.ue()
    bits.u(1)
    bits.skip(2)
    interlaced = not bits.u(1)  # frame_mbs_only_flag
    bits.u(2 if interlaced else 1)
    if bits.u(1):
        bits.skip(4)
    transfer = _told_colour(bits) if bits.u(1) else None
    return FilmHeader(transfer=transfer, interlaced=interlaced)


def _skip_avc_scaling(bits: "_Bits", size: int) -> None:
    last = following = 8
    for _ in range(size):
        if following:
            code = bits.ue()
            following = (last + (code + 1) // 2 * (1 if code % 2 else -1)) % 256
        last = following or last


def _told_colour(bits: "_Bits") -> int | None:
    """The transfer in a video usability information, which begins alike in H.264 and H.265."""
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
    return _told_colour(bits) if bits.u(1) else None


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
