"""What the report of an estimate shows, read from its page: words where they are, and pixels."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image, ImageColor

from skylight._figures import ACCENT
from skylight.estimation import _report as report
from skylight.estimation._page import Page, Panel, Words, font
from skylight.estimation._report import draw_group_report, draw_report, write_report
from skylight.estimation._summary import REGION, PhotoEstimate, probe_title, region_lines
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
def page(result: PhotoEstimate) -> Page:
    return draw_report(result, "someone")


def panel(page: Page, title: str) -> Panel:
    (found,) = [each for name, each in page.panels.items() if name.startswith(title)]
    return found


def said(page: Page, text: str) -> Words:
    (found,) = [words for words in page.words if words.text == text]
    return found


def is_near(page: Page, x: float, y: float, color: str, reach: int = 2) -> bool:
    """Whether a pixel within reach of a place has that colour, or nearly so."""
    row, column = math.floor(y), math.floor(x)
    there = page.canvas[row - reach : row + reach + 1, column - reach : column + reach + 1]
    return bool((np.abs(there - np.array(ImageColor.getrgb(color))).max(2) < 60).any())


def test_model_and_advice_stand_at_the_head(page: Page) -> None:
    top = {words.text for words in page.words if words.y < 80}
    assert {
        "Light of someone",
        "light model: 9 spherical harmonics",
        f"Take care: {ADVICE}",
    } == top


def test_the_light_is_ringed_where_it_is_brightest(page: Page, result: PhotoEstimate) -> None:
    probe = panel(page, f"Light: {result.estimate.verdict.summary}")
    x, y = float(COLUMN), float(ROW)
    assert_ringed(page, probe, x, y)
    assert abs(said(page, "brightest").y - probe.at(x, y)[1]) < 30


def assert_ringed(page: Page, probe: Panel, column: float, row: float) -> None:
    """A circle about a place of the map, and no other."""
    x, y = probe.at(column, row)
    angles = np.radians(np.arange(0, 360, 30))
    around = [(x + 14 * np.cos(a), y + 14 * np.sin(a)) for a in angles]
    assert all(is_near(page, *place, ACCENT) for place in around)
    beside = [(x + 21 * np.cos(a), y + 21 * np.sin(a)) for a in angles if abs(np.cos(a)) < 0.5]
    assert not any(is_near(page, *place, ACCENT) for place in beside)


def test_the_main_light_is_ringed_though_something_else_is_brighter(
    result: PhotoEstimate,
) -> None:
    main = torch.tensor([-1.0, 0.0, 0.0], dtype=torch.float64)
    other = replace(result, estimate=replace(result.estimate, sun_direction=main))
    page = draw_report(other, "someone")
    assert_ringed(page, panel(page, "Light:"), 31.5, 31.5)


def test_the_region_of_the_sun_is_drawn(result: PhotoEstimate) -> None:
    posterior = replace(result.estimate.posterior, is_seen=True)
    seen = replace(result, estimate=replace(result.estimate, posterior=posterior))
    page = draw_report(seen, "someone")
    height, _ = result.estimate.environment.layout
    places = np.concatenate(region_lines(posterior, height))[::2]
    assert len(places) > 10
    inside = places[(places > 1).all(1) & (places[:, 0] < 2 * height - 2)]
    probe = panel(page, "Light:")
    drawn = [is_near(page, *probe.at(*place), REGION) for place in inside.tolist()]
    assert np.mean(drawn) > 0.9  # but for what ring and plate hide


def test_the_longest_title_stays_over_its_map(
    result: PhotoEstimate, monkeypatch: pytest.MonkeyPatch
) -> None:
    unknown = Certainty(word="unknown", within=90.0, reason="")
    verdict = Verdict(light="", direction=unknown, brightness=unknown, colour=unknown)
    title = probe_title(replace(result.estimate.posterior, is_seen=True), verdict)
    title = title.replace("sun's", "lamp's")
    monkeypatch.setattr(report, "probe_title", lambda *_: title)
    page = draw_report(result, "someone")
    words = said(page, title)
    wide = font(words.size, bold=words.bold).getlength(title)
    assert words.x + wide < panel(page, "Diffuse objects").left


def test_the_numbers_are_the_estimates(page: Page, result: PhotoEstimate) -> None:
    column = said(page, "In numbers").x
    rows = [words for words in page.words if words.x >= column and words.y > 570]
    names, values = ([words for words in rows if words.anchor == a] for a in ("ls", "rs"))
    told = {words.y: words.text for words in values}
    numbers = {words.text: told[words.y] for words in names if words.y in told}
    azimuth, zenith = ((COLUMN + 0.5) / 128 - 0.5) * 360, (ROW + 0.5) / 64 * 180
    assert numbers["   right of the camera's view"] == f"{azimuth:+.0f}°"
    assert numbers["   above the horizon"] == f"{90 - zenith:+.0f}°"
    assert numbers["main light"] == ""
    assert "   from the right" in numbers
    red, green, blue = result.estimate.albedo.tolist()
    assert numbers["skin colour (albedo)"].split() == [f"{red:.2f}", f"{green:.2f}", f"{blue:.2f}"]
    residual = result.estimate.faces[0].residual
    assert numbers["re-rendered face off by"] == f"{math.floor(100 * residual + 0.5)} %"
    last = max(words.y for words in rows)
    assert last < page.canvas.shape[0]


def test_the_residual_is_relative_and_leaves_kept_bounds_out(
    page: Page, result: PhotoEstimate
) -> None:
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
    values = report.residual(result.view, result.estimate.faces[0].rendered).numpy()
    np.testing.assert_allclose(values, expected, atol=1e-5)
    # the page shows it at its pixels
    shown, colours = panel(page, "Render minus seen"), report.red_or_blue(values)
    for number in range(0, len(result.view.places), 50):
        row, column = result.view.places[number].tolist()
        x, y = (math.floor(place) for place in shown.at(float(column), float(row)))
        if y < shown.top + 0.88 * shown.height:  # above the bar
            np.testing.assert_array_equal(
                page.canvas[y, x], colours[result.view.blocks[number]], err_msg=str((row, column))
            )


def test_too_bright_is_red_and_too_dark_is_blue() -> None:
    (much, some, none, dark) = report.red_or_blue(np.array([0.9, 0.3, 0.0, -0.3])).astype(int)
    assert much.tolist() == [103, 0, 31]
    assert some[0] > some[2] + 50
    assert dark[2] > dark[0] + 50
    assert np.ptp(none) == 0


def test_the_frame_holds_the_landmarks(page: Page, result: PhotoEstimate) -> None:
    low, high = report.head_window(result.photos[0], result.face)
    (left, top), (right, bottom) = low.astype(float).tolist(), high.astype(float).tolist()
    x, y = result.face.points.T
    assert left <= x.min() < x.max() <= right
    assert top <= y.min() < y.max() <= bottom
    shown = panel(page, "Photograph")
    for corner in ((left, top), (right, top), (left, bottom), (right, bottom)):
        assert is_near(page, *shown.at(*corner), ACCENT, reach=3)


def test_groups_have_a_row_of_pictures_for_each_face(result: PhotoEstimate) -> None:
    (seen,) = result.seen
    light = result.estimate.faces[0]
    count = 6  # more than go into a row
    group = replace(
        result,
        seen=(seen,) * count,
        estimate=replace(result.estimate, faces=(light,) * count),
    )
    page = draw_group_report(group, "a group")
    assert [said(page, f"{number} as seen").text for number in range(1, count + 1)]
    rows = {page.panels[f"{number} as seen"].top for number in range(1, count + 1)}
    assert len(rows) == 2
    assert max(rows) + page.panels["6 as seen"].height < panel(page, "Light:").top
    height, width = page.canvas.shape[:2]
    assert all(0 <= words.x <= width and 0 < words.y < height for words in page.words)


def test_the_file_is_the_page_with_its_words(result: PhotoEstimate, tmp_path: Path) -> None:
    write_report(tmp_path / "report.png", result, title="someone")
    page = draw_report(result, "someone")
    with Image.open(tmp_path / "report.png") as shown:
        assert (shown.width, shown.height) == page.canvas.shape[1::-1]
        codes = np.asarray(shown)
    written = (codes != page.canvas).any(2)
    words = said(page, "Light of someone")
    rows, columns = np.nonzero(written[:52, :900])
    assert rows.min() > words.y - words.size
    assert columns.min() >= words.x - 1
    assert 100 < columns.max() - words.x < font(words.size, bold=True).getlength(words.text) + 1
