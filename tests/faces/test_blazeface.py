"""BlazeFace's squares and candidates, and the networks of faces, run by onnxruntime."""

import cv2
import numpy as np
import pytest

from skylight.faces._blazeface import (
    Square,
    decode,
    network,
    suppress,
    upright,
    views,
)

SHOWN = Square(centre=np.array([300.0, 200.0]), side=120.0, angle_rad=0.4)


@pytest.mark.parametrize(
    ("name", "side", "channels", "sizes"),
    [
        ("face_detector", 128, 3, [896 * 16, 896]),
        ("face_landmarks", 256, 3, [478 * 3, 1, 1]),
        ("hair_segmenter", 512, 4, [512 * 512 * 2]),
    ],
)
def test_what_goes_in_and_out(name, side, channels, sizes):
    made = network(name)
    assert made.side == side
    picture = np.random.default_rng(0).random((side, side, channels), dtype=np.float32)
    outputs = made.run(picture)
    assert [output.size for output in outputs] == sizes
    assert all(np.isfinite(output).all() for output in outputs)
    assert outputs[0].std() > 0


def test_it_is_loaded_once():
    assert network("face_detector") is network("face_detector")


class TestBlazeFace:
    # anchors: row by row, 2 in each of 16 x 16 cells, then 6 in each of 8 x 8
    @pytest.mark.parametrize(
        ("anchor", "centre"),
        [
            (0, (0.5 / 16, 0.5 / 16)),
            (2 * (3 * 16 + 5) + 1, (5.5 / 16, 3.5 / 16)),
            (512, (0.5 / 8, 0.5 / 8)),
            (512 + 6 * (7 * 8 + 2) + 5, (2.5 / 8, 7.5 / 8)),
        ],
    )
    def test_what_it_says_counts_from_the_anchor_on(self, anchor, centre):
        regressors, logits = np.zeros((896, 16), np.float32), np.full(896, -50, np.float32)
        regressors[anchor, :4] = 12.8, -6.4, 25.6, 51.2  # centre's shift and size, of 128
        regressors[anchor, 4:6] = -12.8, 6.4  # an eye
        logits[anchor] = np.log(3)
        (score,), (face,) = decode(regressors, logits)
        x, y = centre
        assert score == pytest.approx(0.75, rel=1e-5)
        np.testing.assert_allclose(face[0], [x + 0.1 - 0.1, y - 0.05 - 0.2], atol=1e-6)
        np.testing.assert_allclose(face[1], [x + 0.1 + 0.1, y - 0.05 + 0.2], atol=1e-6)
        np.testing.assert_allclose(face[2], [x - 0.1, y + 0.05], atol=1e-6)
        np.testing.assert_allclose(face[3:], np.tile(centre, (5, 1)), atol=1e-6)

    def test_nothing_sure_is_nothing(self):
        scores, faces = decode(np.zeros((896, 16), np.float32), np.full(896, -0.1, np.float32))
        assert suppress(scores, faces) == []

    def test_a_face_seen_twice_is_one(self):
        square = np.array([[0.0, 0.0], [1.0, 1.0], *np.full((6, 2), 0.5)])
        faces = np.stack([square + 5, square, square + 0.2])
        first, second = suppress(np.array([0.6, 0.9, 0.8]), faces)
        np.testing.assert_allclose(first, square + 0.2 * 0.8 / 1.7)
        np.testing.assert_allclose(second, square + 5)

    @pytest.mark.parametrize(("height", "width"), [(256, 256), (480, 640), (1000, 90)])
    def test_it_looks_everywhere(self, height, width):
        whole, *parts = views(height, width)
        corners = np.array([[0.0, 0.0], [1.0, 1.0]])
        first, last = whole.to_picture(corners)
        assert (first <= 0).all()
        assert (last >= [width, height]).all()
        assert views(100, 50)[1:] == []  # parts of it would show no more
        # any face up to a quarter of the picture is whole in a part
        side = max(height, width) / 4
        rng = np.random.default_rng(0)
        for corner in rng.random((50, 2)) * np.maximum([width - side, height - side], 0):
            face = np.stack([corner, np.minimum(corner + side, [width, height])])
            spans = [part.to_picture(corners) for part in parts]
            assert any(
                (a <= face[0] + 1e-9).all() and (face[1] <= b + 1e-9).all() for a, b in spans
            )


class TestSquare:
    def test_a_spot_is_cut_out_and_found_again(self):
        # a soft spot at a known place: its centre of mass in the cut leads back to it
        place = np.array([323.3, 171.8])
        y, x = np.indices((400, 600)) + 0.5
        spot = 250 * np.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / (2 * 4**2))
        picture = np.repeat(spot[..., None], 3, 2).round().astype(np.uint8)
        for side in (192, 60, 31):  # finer, half and a quarter as fine as the picture
            cut = SHOWN.cut(picture, side, cv2.BORDER_CONSTANT)[..., 0].astype(np.float64)
            rows, columns = np.indices(cut.shape) + 0.5
            inside = np.array([(cut * columns).sum(), (cut * rows).sum()]) / cut.sum() / side
            np.testing.assert_allclose(SHOWN.to_picture(inside), place, atol=0.15)

    def test_a_whole_picture_is_itself(self):
        picture = np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)
        whole = Square(centre=np.array([32.0, 32.0]), side=64.0, angle_rad=0.0)
        np.testing.assert_array_equal(whole.cut(picture, 64, cv2.BORDER_CONSTANT), picture)

    def test_what_is_pasted_is_what_was_cut(self):
        y, x = np.indices((400, 600)) / 50.0
        picture = (np.sin(x)[..., None] * np.cos(y)[..., None] * [1, 1, 1]).astype(np.float32)
        pasted = SHOWN.paste(SHOWN.cut(picture, 240, cv2.BORDER_CONSTANT)[..., 0].copy(), 400, 600)
        inside = SHOWN.paste(np.ones((240, 240), np.float32), 400, 600)
        assert inside.sum() == pytest.approx(SHOWN.side**2, rel=0.01)
        np.testing.assert_allclose(pasted[inside == 1], picture[..., 0][inside == 1], atol=0.005)

    def test_eyes_are_level_in_it(self):
        box = np.array([[10.0, 20.0], [50.0, 70.0]])
        right, left = np.array([20.0, 40.0]), np.array([40.0, 50.0])
        square = upright(box, right, left)
        across = np.linalg.solve(square.axes, left - right)
        assert across[0] > 0
        assert across[1] == pytest.approx(0, abs=1e-12)
        np.testing.assert_allclose(square.to_picture(np.array([0.5, 0.5])), box.mean(0))
        assert square.side == pytest.approx(1.5 * 50)
