"""What the report of an estimate shows, read from matplotlib's artists."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from skylight.estimation import _report as report
from skylight.estimation._report import write_report
from skylight.estimation._summary import PhotoEstimate, probe_title
from skylight.inverse._verdict import Certainty, Verdict
from skylight.sphere._envmap import EnvironmentMap
from tests.sunny_face import sunny_estimate

ROW, COLUMN = 20, 100  # the brightest pixel of 64 x 128
ADVICE = "the light is unreliable"


@pytest.fixture(scope="module")
def result() -> PhotoEstimate:
    """A face in the light of one pixel, every third of its pixels over-exposed."""
    found = sunny_estimate()
    radiance = torch.full((64, 128, 3), 0.1)
    radiance[ROW, COLUMN] = 50.0
    environment = EnvironmentMap(radiance=radiance)
    estimate = replace(
        found.estimate,
        environment=environment,
        sun_direction=environment.brightest_direction(),
        advice=(ADVICE,),
    )
    seen = found.seen[0]
    clipped = torch.arange(len(seen.view.observation.pixels)) % 3 == 0
    view = replace(seen.view, observation=replace(seen.view.observation, clipped=clipped))
    return replace(found, estimate=estimate, seen=(replace(seen, view=view),))


@pytest.fixture(scope="module")
def figure(result: PhotoEstimate, tmp_path_factory: pytest.TempPathFactory) -> Figure:
    kept = []

    def keep(figure: Figure, path: Path) -> None:
        kept.append(figure)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report, "save", keep)
        write_report(tmp_path_factory.mktemp("report") / "report.png", result, title="someone")
    return kept[0]


def panel(figure: Figure, title: str) -> Axes:
    (found,) = [axes for axes in figure.axes if axes.get_title(loc="left").startswith(title)]
    return found


def test_model_and_advice_stand_at_the_head(figure: Figure) -> None:
    told = [text.get_text() for text in figure.texts]
    assert "Light of someone" in told
    assert "light model: 9 spherical harmonics" in told
    assert f"Take care: {ADVICE}" in told


def test_the_light_is_marked_where_it_is_brightest(figure: Figure, result: PhotoEstimate) -> None:
    probe = panel(figure, f"Light: {result.estimate.verdict.summary}")
    markers = [line for line in probe.lines if line.get_marker() == "o"]
    assert len(markers) == 2
    for marker in markers:
        assert marker.get_xydata() == pytest.approx(np.array([[COLUMN, ROW]]), abs=1e-3)
    (note,) = [text for text in probe.texts if text.get_text() == "brightest"]
    assert note.xy == pytest.approx((COLUMN, ROW), abs=1e-3)


def test_the_main_light_is_marked_though_something_else_is_brighter(
    result: PhotoEstimate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept: list[Figure] = []
    monkeypatch.setattr(report, "save", lambda figure, path: kept.append(figure))
    main = torch.tensor([-1.0, 0.0, 0.0], dtype=torch.float64)
    other = replace(result, estimate=replace(result.estimate, sun_direction=main))
    write_report(tmp_path / "report.png", other, title="someone")
    probe = panel(kept[0], "Light:")
    (note,) = [text for text in probe.texts if text.get_text() == "brightest"]
    assert note.xy == pytest.approx((31.5, 31.5), abs=1e-3)


def test_the_longest_title_stays_over_its_map(
    result: PhotoEstimate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept: list[Figure] = []
    monkeypatch.setattr(report, "save", lambda figure, path: kept.append(figure))
    unknown = Certainty(word="unknown", within=90.0, reason="")
    verdict = Verdict(light="", direction=unknown, brightness=unknown, colour=unknown)
    title = probe_title(replace(result.estimate.posterior, is_seen=True), verdict)
    title = title.replace("sun's", "lamp's")
    monkeypatch.setattr(report, "probe_title", lambda *_: title)
    write_report(tmp_path / "report.png", result, title="someone")
    kept[0].draw_without_rendering()
    beside = panel(kept[0], "Diffuse objects").get_window_extent().x0
    assert panel(kept[0], title).get_tightbbox().x1 < beside


def test_the_numbers_are_the_estimates(figure: Figure, result: PhotoEstimate) -> None:
    told = [text.get_text() for text in panel(figure, "In numbers").texts]
    numbers = dict(zip(told[::2], told[1::2], strict=True))
    azimuth, zenith = ((COLUMN + 0.5) / 128 - 0.5) * 360, (ROW + 0.5) / 64 * 180
    assert numbers["   right of the camera's view"] == f"{azimuth:+.0f}°"
    assert numbers["   above the horizon"] == f"{90 - zenith:+.0f}°"
    assert numbers["main light"] == ""
    assert "   from the right" in numbers
    red, green, blue = result.estimate.albedo.tolist()
    assert numbers["skin colour (albedo)"].split() == [f"{red:.2f}", f"{green:.2f}", f"{blue:.2f}"]
    residual = result.estimate.faces[0].residual
    assert numbers["re-rendered face off by"] == f"{math.floor(100 * residual + 0.5)} %"


def test_the_residual_is_relative_and_leaves_kept_bounds_out(
    figure: Figure, result: PhotoEstimate
) -> None:
    (shown,) = panel(figure, "Render minus seen").images
    assert isinstance(shown, AxesImage)
    observation = result.view.observation
    assert observation.clipped is not None
    weights = np.array([0.2126, 0.7152, 0.0722])  # Rec. 709
    seen, rendered = (
        part.double().numpy() @ weights
        for part in (observation.pixels, result.estimate.faces[0].rendered)
    )
    expected = (rendered - seen) / seen.mean()
    kept = observation.clipped.numpy() & (rendered > seen)
    assert kept.any()
    expected[kept] = 0
    values = np.ma.filled(shown.get_array(), np.nan)
    rows, columns = result.view.places.T.numpy()
    expected = expected[result.view.blocks.numpy()]
    np.testing.assert_allclose(values[rows, columns], expected, atol=1e-5)
    assert np.isfinite(values).sum() == len(expected)
    # too bright is red, too dark is blue
    red, _, blue, _ = np.asarray(shown.to_rgba(np.array([0.3, -0.3]))).T
    assert red[0] > blue[0]
    assert red[1] < blue[1]


def test_the_frame_holds_the_landmarks(figure: Figure, result: PhotoEstimate) -> None:
    (frame,) = panel(figure, "Photograph").patches
    (left, top), (right, bottom) = frame.get_bbox().get_points()
    x, y = result.face.points.T
    assert left <= x.min() < x.max() <= right
    assert top <= y.min() < y.max() <= bottom
