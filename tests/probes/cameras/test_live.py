"""Photographs, films and what is wrong with them."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from skylight.errors import InputError
from skylight.probes.cameras._board import Board
from skylight.probes.cameras._live import Frame, read_frames, read_picture, sharp_and_different
from tests.probes.cameras.scenes import LENS, board_from_tilt, picture_of_board


def scene(seed: int) -> np.ndarray:
    """Coarse and fine structure."""
    generator = np.random.default_rng(seed)
    coarse = generator.integers(0, 255, (6, 8)).astype(np.uint8)
    return np.repeat(
        cv2.resize(coarse, (128, 96), interpolation=cv2.INTER_NEAREST)[..., None], 3, 2
    )


def write_film(path: Path, pictures: list[np.ndarray]) -> None:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10, (128, 96))
    for picture in pictures:
        writer.write(picture)
    writer.release()


class TestPhotographs:
    def test_grey_and_colour_are_read_as_rgb(self, tmp_path: Path) -> None:
        Image.fromarray(scene(0)[..., 0]).save(tmp_path / "grey.png")
        red = scene(0) * np.array([1, 0, 0], dtype=np.uint8)
        Image.fromarray(red).save(tmp_path / "red.png")
        first, second = read_frames([tmp_path / "grey.png", tmp_path / "red.png"])
        np.testing.assert_array_equal(first.image, scene(0))
        np.testing.assert_array_equal(second.image, red)
        assert second.name.endswith("red.png")

    def test_sizes_that_differ(self, tmp_path: Path) -> None:
        Image.fromarray(scene(0)).save(tmp_path / "a.png")
        Image.fromarray(scene(0)[:50]).save(tmp_path / "b.png")
        with pytest.raises(InputError, match=r"b.png: 128x50 pixels, but .*a.png has 128x96"):
            list(read_frames([tmp_path / "a.png", tmp_path / "b.png"]))

    def test_a_camera_held_upside_down_between(self, tmp_path: Path) -> None:
        exif = Image.Exif()
        exif[0x0112] = 3
        Image.fromarray(scene(0)).save(tmp_path / "a.jpg")
        Image.fromarray(scene(0)).save(tmp_path / "b.jpg", exif=exif)
        with pytest.raises(InputError, match="held another way"):
            list(read_frames([tmp_path / "a.jpg", tmp_path / "b.jpg"]))

    def test_16_bits_are_seen_as_8(self, tmp_path: Path) -> None:
        grey = scene(0)[..., 0]
        Image.fromarray(grey.astype(np.uint16) * 257).save(tmp_path / "deep.png")
        expected = np.repeat(grey[..., None], 3, -1)
        np.testing.assert_array_equal(read_picture(tmp_path / "deep.png").image, expected)

    def test_what_is_no_picture(self, tmp_path: Path) -> None:
        (tmp_path / "a.jpg").write_bytes(b"nothing")
        with pytest.raises(InputError, match="no picture known here"):
            read_picture(tmp_path / "a.jpg")
        with pytest.raises(InputError, match="cannot read"):
            read_picture(tmp_path / "none.jpg")
        Image.fromarray(scene(3)).save(tmp_path / "whole.png")
        (tmp_path / "cut.png").write_bytes((tmp_path / "whole.png").read_bytes()[:120])
        with pytest.raises(InputError, match=r"cut.png"):
            read_picture(tmp_path / "cut.png")

    def test_none(self) -> None:
        with pytest.raises(InputError, match="no pictures"):
            read_frames([])


class TestFilms:
    def test_one_frame_of_each_scene_and_the_sharp_one(self, tmp_path: Path) -> None:
        film = []
        for number in range(4):
            blurred = cv2.GaussianBlur(scene(number), (0, 0), 2)
            film += [blurred] * 6 + [scene(number)] + [blurred] * 13
        write_film(tmp_path / "film.avi", film)
        found = list(read_frames(tmp_path / "film.avi"))
        assert [frame.name.rpartition(" ")[2] for frame in found] == ["7", "27", "47", "67"]
        assert np.abs(found[1].image.astype(int) - scene(1)).mean() < 4

    def test_at_most_as_many_as_asked(self) -> None:
        frames = [Frame(name=str(i), image=scene(i // 10)) for i in range(120)]
        found = list(sharp_and_different(frames, most=5))
        assert len(found) == 5

    def test_a_tilt_is_another_view_and_a_change_of_exposure_is_none(self) -> None:
        board = Board(columns=8, rows=6, square_mm=30.0, marker_mm=21.0)
        flat, tilted = (
            picture_of_board(board, LENS, *board_from_tilt(board, tilt, 0, 0, [0, 0, 800]))
            for tilt in (0, 15)
        )
        film = [flat] * 10 + [np.clip(flat.astype(int) + 8, 0, 255).astype(np.uint8)] * 10
        frames = [Frame(name=str(i), image=image) for i, image in enumerate(film + [tilted] * 10)]
        assert [frame.name for frame in sharp_and_different(frames, most=9)] == ["0", "20"]

    def test_no_film(self, tmp_path: Path) -> None:
        (tmp_path / "film.mp4").write_bytes(b"nothing" * 100)
        with pytest.raises(InputError, match="cannot open"):
            list(read_frames(tmp_path / "film.mp4"))
        with pytest.raises(InputError, match="no such file"):
            list(read_frames(tmp_path / "none.mp4"))

    def test_no_webcam(self) -> None:
        with pytest.raises(InputError, match="webcam 93: see that it is plugged in"):
            list(read_frames(93))
