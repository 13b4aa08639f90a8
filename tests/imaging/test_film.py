"""Films: upright, in time, and what is refused."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from skylight.errors import InputError
from skylight.imaging._film import film_frames
from skylight.imaging._film_headers import FilmHeader, film_header
from tests.films import (
    box,
    ticks_a_second,
    with_frame_times,
    with_in_description,
    with_quarter_turn,
    write_film,
)

STEP = 20  # codes between frames: MPEG-4 keeps an even frame within a few


def counting(count: int) -> list[np.ndarray]:
    """Frame k is of the grey 20 + 20 k."""
    return [np.full((48, 64, 3), 20 + STEP * k, np.uint8) for k in range(count)]


def shades(film: Path, **options: float) -> list[int]:
    return [round((f.codes.mean() - 20) / STEP) for f in film_frames(film, **options)]


def test_frames_come_in_order_at_the_rate(tmp_path: Path) -> None:
    film = write_film(tmp_path / "film.mp4", counting(8), rate=10)
    assert shades(film) == list(range(8))
    times = [frame.time_s for frame in film_frames(film)]
    np.testing.assert_allclose(times, np.arange(8) / 10, atol=1e-3)


def test_of_a_faster_film_so_many_a_second(tmp_path: Path) -> None:
    film = write_film(tmp_path / "film.mp4", counting(10), rate=20)
    assert shades(film, most_a_second=10.0) == [0, 2, 4, 6, 8]
    # 20 a second thinned to 8: every 2.5th
    assert shades(film, most_a_second=8.0) == [0, 2, 5, 7]


def test_of_a_very_wide_film_a_row_is_left(tmp_path: Path) -> None:
    film = write_film(tmp_path / "film.mp4", [frame[:2] for frame in counting(2)])
    shapes = [frame.codes.shape for frame in film_frames(film, most_side=16)]
    assert shapes == [(1, 16, 3)] * 2


def test_each_frame_has_the_time_at_which_it_is_shown(tmp_path: Path) -> None:
    film = write_film(tmp_path / "film.mp4", counting(6), rate=10)
    unit = ticks_a_second(film) // 20  # 50 ms
    with_frame_times(film, [2 * unit, unit, 6 * unit, unit, unit, unit])
    times = [frame.time_s for frame in film_frames(film)]
    np.testing.assert_allclose(times, [0, 0.1, 0.15, 0.45, 0.5, 0.55], atol=2e-3)
    assert shades(film) == list(range(6))


def test_a_film_that_asks_to_be_turned_is_upright(tmp_path: Path) -> None:
    picture = np.full((48, 64, 3), 30, np.uint8)
    picture[:24, :32] = 220  # up left, which a clockwise turn brings up right
    film = write_film(tmp_path / "film.mp4", [picture] * 2)
    with_quarter_turn(film)
    frame = next(film_frames(film))
    assert frame.codes.shape == (64, 48, 3)
    assert frame.codes[:30, 26:].mean() > 200
    assert frame.codes[:30, :22].mean() < 50


@pytest.mark.parametrize(("number", "name"), [(16, "PQ"), (18, "HLG")])
@pytest.mark.parametrize("kind", [b"nclx", b"nclc"])
def test_high_dynamic_range_is_refused_by_name(
    tmp_path: Path, number: int, name: str, kind: bytes
) -> None:
    film = write_film(tmp_path / "film.mp4", counting(2))
    colour = kind + b"".join(n.to_bytes(2, "big") for n in (9, number, 9))
    with_in_description(film, box(b"colr", colour))
    with pytest.raises(InputError, match=rf"film.mp4: .*{name}.*export it as SDR"):
        next(film_frames(film))


def test_sdr_named_in_the_file_is_read(tmp_path: Path) -> None:
    film = write_film(tmp_path / "film.mp4", counting(2))
    assert film_header(film).transfer in (None, 1)
    with_in_description(film, box(b"colr", b"nclx" + bytes([0, 1, 0, 1, 0, 1, 0])))
    assert film_header(film).transfer == 1
    assert shades(film) == [0, 1]


class Bits:
    """Writes H.265 syntax elements."""

    def __init__(self) -> None:
        self.text = ""

    def u(self, count: int, value: int) -> "Bits":
        self.text += f"{value:0{count}b}" if count else ""
        return self

    def ue(self, *values: int) -> "Bits":
        for value in values:
            digits = f"{value + 1:b}"
            self.text += "0" * (len(digits) - 1) + digits
        return self

    def payload(self) -> bytes:
        text = self.text + "1" + "0" * (-(len(self.text) + 1) % 8)
        raw = bytes(int(text[i : i + 8], 2) for i in range(0, len(text), 8))
        out, zeros = bytearray(), 0
        for byte in raw:  # keep start codes out, as H.265 7.3.1.1 asks
            if zeros >= 2 and byte <= 3:
                out.append(3)
                zeros = 0
            out.append(byte)
            zeros = zeros + 1 if byte == 0 else 0
        return bytes(out)


def sequence_parameters(transfer: int, *, layers: int, lists: bool) -> bytes:
    """An HEVC sequence parameter set with every optional part that stands before the transfer."""
    bits = Bits().u(4, 0).u(3, layers).u(1, 1).u(8, 2).u(88, 0x20000000 << 56)
    for _ in range(layers):
        bits.u(1, 1).u(1, 1)
    if layers:
        bits.u(2 * (8 - layers), 0)
    for _ in range(layers):
        bits.u(88, 5).u(8, 93)
    bits.ue(0, 1, 1920, 1080).u(1, 1).ue(0, 0, 0, 4).ue(2, 2, 4)
    bits.u(1, 0).ue(4, 2, 5)  # one order for all layers
    bits.ue(0, 3, 0, 3, 0, 0).u(1, lists)
    if lists:
        bits.u(1, 1)
        for size in range(4):
            for matrix in range(2 if size == 3 else 6):
                if matrix == 0:  # told outright: signed Exp-Golomb, as ue is skipped alike
                    bits.u(1, 1).ue(*([3] * (size > 1))).ue(*([1] * min(64, 16 << (2 * size))))
                else:
                    bits.u(1, 0).ue(0)
    bits.u(1, 1).u(1, 1).u(1, 1).u(8, 0x77).ue(0, 2).u(1, 0)
    # two reference sets, the second told by the first
    bits.ue(2).ue(2, 1)
    for _ in range(3):
        bits.ue(0).u(1, 1)
    bits.u(1, 1).u(1, 0).ue(0).u(1, 1).u(1, 0).u(1, 1).u(1, 0).u(1, 1).u(1, 1)
    bits.u(1, 1).ue(1).u(8, 7).u(1, 1)  # a long-term picture, of 4 + 4 bits
    bits.u(1, 1).u(1, 1).u(1, 1).u(1, 1).u(8, 255).u(16, 1).u(16, 1).u(1, 1).u(1, 0)
    bits.u(1, 1).u(3, 5).u(1, 0).u(1, 1).u(8, 9).u(8, transfer).u(8, 9)
    return bytes([33 << 1, 1]) + bits.payload()


@pytest.mark.parametrize("transfer", [1, 16, 18])
@pytest.mark.parametrize("layers", [0, 2])
@pytest.mark.parametrize("lists", [False, True])
def test_without_a_colour_box_the_coded_video_tells(
    tmp_path: Path, transfer: int, layers: int, lists: bool
) -> None:
    film = write_film(tmp_path / "film.mp4", counting(2))
    units = sequence_parameters(transfer, layers=layers, lists=lists)
    array = bytes([33, 0, 1]) + len(units).to_bytes(2, "big") + units
    with_in_description(film, box(b"hvcC", bytes(22) + b"\1" + array))
    assert film_header(film).transfer == transfer
    whole = film.read_bytes()
    place = whole.rindex(units)
    film.write_bytes(whole[: place + 30])  # cut within it: passed over
    assert film_header(film).transfer is None


def test_a_box_whose_header_ends_outside_its_parent_is_passed_over(tmp_path: Path) -> None:
    film = tmp_path / "film.mp4"
    longer = (1).to_bytes(4, "big") + b"stsd"  # of a length that follows, in eight bytes
    film.write_bytes(box(b"moov", longer) + (16).to_bytes(8, "big") + bytes(64))
    assert film_header(film).transfer is None


def test_what_is_no_film(tmp_path: Path) -> None:
    (tmp_path / "film.mp4").write_bytes(b"nothing" * 100)
    with pytest.raises(InputError, match="cannot open"):
        next(film_frames(tmp_path / "film.mp4"))
    with pytest.raises(InputError, match="no such file"):
        next(film_frames(tmp_path / "none.mp4"))


def test_what_decoders_say_of_a_damaged_film_is_not_printed(tmp_path: Path) -> None:
    film = write_film(tmp_path / "film.mp4", counting(4))
    content = bytearray(film.read_bytes())
    start = content.index(b"mdat") + 4
    content[start + 30 : start + 50] = b"skylight" + bytes(12)
    film.write_bytes(content)
    other = tmp_path / "film.avi"
    other.write_bytes(b"RIFF" + (1000).to_bytes(4, "little") + b"AVI nothing" * 90)
    program = (
        "import sys; from pathlib import Path; from skylight.errors import InputError; "
        "from skylight.imaging._film import film_frames\n"
        "for name in sys.argv[1:]:\n"
        "    try: print(len(list(film_frames(Path(name)))))\n"
        "    except InputError as error: print(error)"
    )
    command = [sys.executable, "-c", program, str(film), str(other)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    read, refused = done.stdout.splitlines()
    assert 0 < int(read) <= 4
    assert "cannot open" in refused
    assert done.stderr == ""


def test_of_a_film_cut_short_the_frames_that_are_there(tmp_path: Path) -> None:
    """A file whose index stands in front plays until where its bytes end."""
    import cv2

    noise = np.random.default_rng(0).integers(0, 255, (30, 48, 64, 3)).astype(np.uint8)
    path = tmp_path / "film.avi"
    made = cv2.VideoWriter(
        str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (64, 48)
    )
    for frame in noise:
        made.write(frame)
    made.release()
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    assert 5 < len(list(film_frames(path))) < 25


def test_boxes_that_lie_are_passed_over(tmp_path: Path) -> None:
    """Bytes changed, cut and doubled: no answer, or a number, and in no time."""
    film = write_film(tmp_path / "film.mp4", counting(1))
    units = sequence_parameters(16, layers=1, lists=True)
    array = bytes([33, 255, 255]) + len(units).to_bytes(2, "big") + units
    with_in_description(film, box(b"hvcC", bytes(22) + b"\xff" + array))
    whole, rng = film.read_bytes(), np.random.default_rng(0)
    start = whole.index(b"moov") - 4
    for _ in range(300):
        changed = bytearray(whole)
        for place in rng.integers(start, len(whole), rng.integers(1, 6)):
            changed[place] = rng.choice([0, 1, 127, 255, int(rng.integers(256))])
        film.write_bytes(bytes(changed[: rng.integers(start, len(whole) + 1)]))
        told = film_header(film).transfer
        assert told is None or told >= 0


def avc_configuration(transfer: int, *, fields: bool, high: bool) -> bytes:
    """An avcC box of a sequence parameter set with every optional part before the transfer."""
    bits = Bits().u(8, 100 if high else 77).u(8, 0).u(8, 31).ue(0)
    if high:
        bits.ue(1, 0, 0).u(1, 0).u(1, 1)
        for size in (16, 16, 16, 16, 16, 16, 64, 64):
            # the first list as told, the second ends at once: -8 leaves what is left alike
            bits.u(1, 1)
            bits.ue(2, 2, 2, 10) if size == 64 else bits.ue(*([1] + [0] * (size - 1)))
    bits.ue(0, 1).u(1, 0).ue(2, 1, 2, 4, 4)  # pictures ordered by a cycle of two
    bits.ue(1).u(1, 0).ue(3, 2).u(1, not fields)
    if fields:
        bits.u(1, 1)
    bits.u(1, 1).u(1, 1).ue(0, 0, 0, 1).u(1, 1)
    bits.u(1, 1).u(8, 255).u(16, 4).u(16, 3).u(1, 1).u(1, 0)
    bits.u(1, 1).u(3, 5).u(1, 0).u(1, 1).u(8, 9).u(8, transfer).u(8, 9)
    unit = b"\x67" + bits.payload()
    return box(b"avcC", b"\1d\0\x1f\xff\xe1" + len(unit).to_bytes(2, "big") + unit)


@pytest.mark.parametrize("transfer", [1, 18])
@pytest.mark.parametrize("fields", [False, True])
@pytest.mark.parametrize("high", [False, True])
def test_what_avc_tells(tmp_path: Path, transfer: int, fields: bool, high: bool) -> None:
    film = write_film(tmp_path / "film.mp4", counting(1))
    with_in_description(film, avc_configuration(transfer, fields=fields, high=high))
    assert film_header(film) == FilmHeader(transfer=transfer, interlaced=fields)


@pytest.mark.parametrize(
    "told", [box(b"fiel", b"\2\6"), avc_configuration(1, fields=True, high=True)]
)
def test_interlaced_films_that_the_decoder_leaves_alone_are_refused(
    tmp_path: Path, told: bytes
) -> None:
    """It says that they are good, and gives the memory of before; moving ones it has converted."""
    for frames in ([counting(1)[0]] * 3, [counting(1)[0]] * 20):
        film = write_film(tmp_path / "film.mp4", frames)
        with_in_description(film, told)
        with pytest.raises(InputError, match=r"interlaced.*progressive"):
            list(film_frames(film))
    film = write_film(tmp_path / "film.mp4", counting(4))
    with_in_description(film, told)
    assert shades(film) == [0, 1, 2, 3]


def test_of_codecs_that_do_not_tell_of_fields_long_still_films_are_refused(tmp_path: Path) -> None:
    """MPEG-4, MPEG-2, DV and ProRes: the decoder leaves fields alone there too."""
    film = write_film(tmp_path / "film.mp4", [counting(1)[0]] * 12)
    assert film_header(film).interlaced is None
    for rate in (2.0, 1000.0):
        with pytest.raises(InputError, match=r"all alike.*interlaced.*progressive"):
            list(film_frames(film, most_a_second=rate))
    with_in_description(film, avc_configuration(1, fields=False, high=True))
    assert shades(film) == [0] * 12
    assert shades(write_film(film, [counting(1)[0]] * 11)) == [0] * 11
    assert shades(write_film(film, [*[counting(1)[0]] * 19, *counting(3)])) == [0] * 20 + [1, 2]


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize(("wide", "high", "shape"), [(8, 5, (48, 102)), (1, 2, (48, 32))])
def test_pixels_that_are_not_square_are_shown_as_wide_as_they_are(
    tmp_path: Path, turned: bool, wide: int, high: int, shape: tuple[int, int]
) -> None:
    film = write_film(tmp_path / "film.mp4", counting(2))
    data = film.read_bytes()
    place = data.find(b"pasp")
    told = wide.to_bytes(4, "big") + high.to_bytes(4, "big")
    if place < 0:
        with_in_description(film, box(b"pasp", told))
    else:
        film.write_bytes(data[: place + 4] + told + data[place + 12 :])
    if turned:
        with_quarter_turn(film)
    (first, second) = film_frames(film)
    assert first.codes.shape[:2] == (shape[::-1] if turned else shape)
    assert round((second.codes.mean() - 20) / STEP) == 1
    assert max(next(film_frames(film, most_side=24)).codes.shape) == 24


def element(name: int, content: bytes) -> bytes:
    """An identifier, a length of eight bytes and a content."""
    length = (len(content) | 1 << 56).to_bytes(8, "big")
    return name.to_bytes((name.bit_length() + 7) // 8, "big") + length + content


@pytest.mark.parametrize(("number", "name"), [(16, "PQ"), (18, "HLG")])
def test_high_dynamic_range_in_matroska(tmp_path: Path, number: int, name: str) -> None:
    """By its element, or by the coded video's parameters; sound may come first."""
    units = sequence_parameters(number, layers=0, lists=False)
    array = bytes([33, 0, 1]) + len(units).to_bytes(2, "big") + units
    codec = element(0x86, b"V_MPEGH/ISO/HEVC")
    private = element(0x63A2, bytes(22) + b"\1" + array)
    colour = element(0x55B0, element(0x55BA, bytes([number])))
    for inside in (element(0xE0, colour), codec + private):
        sound = element(0xAE, element(0x86, b"A_OPUS") + element(0x83, b"\2"))
        track = element(0xAE, inside + element(0x83, b"\1"))
        tracks = element(0x1654AE6B, sound + track)
        void = element(0xEC, bytes(300))
        content = element(0x1A45DFA3, b"") + element(0x18538067, void + tracks)
        (tmp_path / "film.mkv").write_bytes(content)
        with pytest.raises(InputError, match=rf"film.mkv: .*{name}.*export it as SDR"):
            next(film_frames(tmp_path / "film.mkv"))


def test_a_matroska_file_as_it_is_written(tmp_path: Path) -> None:
    film = write_film(tmp_path / "film.mkv", counting(3))
    assert film_header(film).transfer in (None, 1)
    assert shades(film) == [0, 1, 2]
    fields = element(0xAE, element(0x83, b"\1") + element(0xE0, element(0x9A, b"\1")))
    (tmp_path / "fields.mkv").write_bytes(
        element(0x1A45DFA3, b"") + element(0x18538067, element(0x1654AE6B, fields))
    )
    assert film_header(tmp_path / "fields.mkv").interlaced
    for cut in range(0, 600, 7):
        (tmp_path / "cut.mkv").write_bytes(film.read_bytes()[:cut])
        film_header(tmp_path / "cut.mkv")


def test_films_of_other_programs(shared_data: Path) -> None:
    """What phones and encoders write: see the README there."""
    folder = shared_data / "awkward"
    with pytest.raises(InputError, match="interlaced"):
        list(film_frames(folder / "face_interlaced.mp4"))
    with pytest.raises(InputError, match="codec AV01"):
        list(film_frames(folder / "face_av1.mp4"))
    with pytest.raises(InputError, match="HLG"):
        list(film_frames(folder / "hlg_iphone.mov"))
    square, wide = (next(film_frames(folder / f"face{n}.mp4")).codes for n in ("", "_sar"))
    assert square.shape == wide.shape == (320, 256, 3)
    assert np.abs(square.astype(float) - wide).mean() < 6
