"""Light that a face sends into its own hollows."""

from dataclasses import replace

import numpy as np
import torch

from skylight.portrait._bounce import ALBEDO, bounced, hollow_tint, hue_of
from skylight.portrait._gain import LUMINANCE_WEIGHTS
from tests.portrait.test_relit import even, image, on_skin, portrait, sunny
from tests.sunny_face import direction


def test_a_hollow_is_as_bright_as_an_integrating_sphere() -> None:
    """Against all bounces between patches, each of which sees of all others its share."""
    rng = np.random.default_rng(3)
    open_, count = 0.3, 400
    drawn = rng.uniform(0, 1, (20, 20))
    direct = (1 + drawn - drawn[:, ::-1]).reshape(-1)  # whose mean is 1 at both sides of a picture
    seen = np.full((count, count), (1 - open_) / count)  # of a sphere every form factor is the same
    whole = np.linalg.solve(np.eye(count) - ALBEDO * seen, direct)
    size = (20, 20)
    got = bounced(
        direct.reshape(size), np.full(size, open_), np.ones(size, np.float32), face_px=200.0
    )
    np.testing.assert_allclose(got.reshape(-1), whole - direct, rtol=1e-3)


def test_what_sees_all_of_the_light_gets_none_of_the_face() -> None:
    ones = np.ones((8, 8), np.float32)
    np.testing.assert_array_equal(bounced(ones, ones, ones, 4.0), 0)
    assert bounced(ones, 0.5 * ones, ones, 4.0).min() > 0


def test_light_from_skin_has_its_colour_and_no_other_brightness() -> None:
    hue = hue_of(np.array([0.3, -0.1, -0.5]))
    shares = np.linspace(0, 0.9, 4)
    tint = np.exp(hollow_tint(shares, hue))
    np.testing.assert_allclose(tint @ LUMINANCE_WEIGHTS, 1, rtol=1e-6)
    np.testing.assert_array_equal(tint[0], 1)
    assert (np.diff(tint[:, 0] / tint[:, 2]) > 0).all()


def test_eye_sockets_are_hollow_and_redder_and_brighter_from_above() -> None:
    """Where a lamp from above leaves the face in shadow the face itself lights it, and warmly."""
    one = portrait(even(), image(even()))
    assert one.hue[0] > 1 > one.hue[2]
    above = sunny(0.0, 30.0)
    shading, _ = one.shaded_by(above)
    share = one.on.share_of(one.bounced(shading), shading)
    lit = shading @ LUMINANCE_WEIGHTS
    inner = on_skin() & (one.on.face > 0)
    dark = inner & (lit < np.quantile(lit[inner], 0.1))
    assert share[dark].mean() > 2 * share[inner].mean()
    assert share.min() >= 0
    assert share.max() < 0.7
    assert (one.openness[inner] < 1.01).all()

    def red(of: np.ndarray) -> np.ndarray:
        return np.log(of[..., 0] / of[..., 2])

    lamp = even(0.01).with_light(direction(0.0, 30.0), torch.ones(3))  # and nearly nothing else
    relit = one.gains(lamp).times
    grey_skin = replace(one, hue=np.ones_like(one.hue)).gains(lamp).times
    redder = red(relit) - red(grey_skin)
    assert redder[dark].mean() > max(0.02, 2 * redder[inner].mean())
    isolated = replace(one, openness=np.ones_like(one.openness)).gains(lamp).times
    assert relit[dark].mean() / isolated[dark].mean() > 1.05
