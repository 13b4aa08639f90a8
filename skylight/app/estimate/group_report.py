"""The report figure of an estimate from several faces."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

from skylight.app.estimate.face_panels import LIGHTS, frame_head, over_grey, rgb, show_residual
from skylight.app.estimate.summary import where
from skylight.app.estimate.types import PhotoEstimate
from skylight.app.estimate.uncertainty import draw_region, probe_title
from skylight.app.figures.angles import angles_deg
from skylight.app.figures.exposure import white_of
from skylight.app.figures.panels import show, show_probe, write_numbers
from skylight.app.figures.relit import SCENE_GRID, SCENE_HEIGHT, relit
from skylight.app.figures.style import ACCENT, MUTED, STYLE, save
from skylight.imaging.colour import tone_map
from skylight.transport.scene.evaluation import evaluation_scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import SubFigure

ABREAST = 4
WIDTH, PHOTO_ROW, FACE_ROW, LIGHT_ROW = 16.0, 3.6, 1.8, 6.0  # inches


def write_group_report(path: Path, result: PhotoEstimate, *, title: str) -> None:
    """Write the report as a PNG 1920 pixels wide, taller the more faces there are.

    Faces have the numbers of estimate.json and of the meshes' files.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    rows = (
        PHOTO_ROW * math.ceil(len(result.photos) / ABREAST),
        FACE_ROW * math.ceil(len(result.seen) / ABREAST),
        LIGHT_ROW,
    )
    notes = [f"Take care: {line}" for line in result.estimate.advice]
    head = 0.75 + 0.22 * len(notes)
    height = head + sum(rows)
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, height), dpi=120, facecolor="white")
        top = 1 - 0.42 / height
        figure.text(0.02, top, f"Light of {title}", fontsize=17, fontweight="bold")
        light = LIGHTS[result.estimate.light]
        figure.text(0.98, top, light, ha="right", color=MUTED, fontsize=11.5)
        for number, note in enumerate(notes, start=1):
            at = top - 0.24 * number / height
            figure.text(0.02, at, note, color=ACCENT, fontsize=9.5)
        parts = figure.add_gridspec(4, 1, height_ratios=(head, *rows), hspace=0, top=1, bottom=0)
        _photos(figure.add_subfigure(parts[1]), result)
        _faces(figure.add_subfigure(parts[2]), result)
        _light(figure.add_subfigure(parts[3]), result)
        save(figure, path)


def _photos(area: "SubFigure", result: PhotoEstimate) -> None:
    """All photographs, with the numbers of the faces that were used."""
    photos = result.photos
    for number, (photo, axes) in enumerate(
        zip(photos, _cells(area, len(photos)), strict=True), start=1
    ):
        show(axes, photo.encoded, "Photograph" if len(photos) == 1 else f"Photograph {number}")
    for number, seen in enumerate(result.seen, start=1):
        axes, photo = area.axes[seen.photo], photos[seen.photo]
        left, top = frame_head(axes, photo, seen.face)
        axes.text(
            left,
            top,
            str(number),
            color="white",
            fontsize=9,
            fontweight="bold",
            va="bottom",
            bbox={"boxstyle": "square,pad=0.2", "facecolor": ACCENT, "edgecolor": "none"},
        )


def _cells(area: "SubFigure", count: int) -> "list[Axes]":
    rows = math.ceil(count / ABREAST)
    grid = area.add_gridspec(
        rows,
        min(count, ABREAST),
        left=0.02,
        right=0.98,
        top=1 - 0.1 / rows,
        bottom=0.03,
        wspace=0.08,
        hspace=0.16,
    )
    return [area.add_subplot(grid[k // ABREAST, k % ABREAST]) for k in range(count)]


def _faces(area: "SubFigure", result: PhotoEstimate) -> None:
    """Each face as seen, as re-rendered, and what lies between."""
    white: dict[int, float] = {}  # of a photograph: its brightest face must not burn out
    for seen in result.seen:
        level = white_of(seen.view.observation.pixels)
        white[seen.photo] = max(level, white.get(seen.photo, 0.0))
    rows = math.ceil(len(result.seen) / ABREAST)
    grid = area.add_gridspec(
        rows, ABREAST, left=0.02, right=0.98, top=1 - 0.16 / rows, bottom=0.02, wspace=0.06
    )
    for k, (seen, light) in enumerate(zip(result.seen, result.estimate.faces, strict=True)):
        cell = grid[k // ABREAST, k % ABREAST].subgridspec(1, 3, wspace=0.06)
        axes = [area.add_subplot(part) for part in cell]
        scale = white[seen.photo]
        show(axes[0], tone_map(seen.view.image, white=scale), f"{k + 1} as seen")
        pasted = over_grey(seen.view.image, seen.view.places, light.rendered[seen.view.blocks])
        show(axes[1], tone_map(pasted, white=scale), "re-rendered")
        off = f"off by {100 * light.residual:.0f} %"
        show_residual(axes[2], seen.view, light.rendered, off)


def _light(area: "SubFigure", result: PhotoEstimate) -> None:
    """The light, things in it, and the numbers."""
    environment, posterior = result.estimate.environment, result.estimate.posterior
    found = area.add_gridspec(
        2,
        3,
        width_ratios=(2.9, 0.93, 1.15),
        left=0.02,
        right=0.98,
        top=0.93,
        bottom=0.06,
        wspace=0.06,
        hspace=0.18,
    )
    probe = area.add_subplot(found[:, 0])
    show_probe(probe, environment, probe_title(posterior))
    draw_region(probe, posterior, environment.layout[0])
    matt, metal = relit(evaluation_scene(SCENE_HEIGHT, SCENE_GRID), environment)
    show(area.add_subplot(found[0, 1]), matt, "Matt objects in this light")
    show(area.add_subplot(found[1, 1]), metal, "Metal objects in this light")
    rows = _shared_numbers(result)
    pitch = min(0.053, 1 / (len(rows) + 1))
    write_numbers(area.add_subplot(found[:, 2]), "In numbers", rows, pitch=pitch)


def _shared_numbers(result: PhotoEstimate) -> list[tuple[str, str]]:
    estimate = result.estimate
    azimuth_deg, zenith_deg = angles_deg(estimate.sun_direction)
    return [
        ("brightest", where(azimuth_deg, zenith_deg)),
        ("   azimuth, right of ahead", f"{azimuth_deg:+.0f}°"),
        ("   zenith angle", f"{zenith_deg:.0f}°"),
        ("ground albedo", rgb(estimate.ground_albedo)),
        *(
            (f"skin albedo of face {number}", rgb(face.albedo))
            for number, face in enumerate(estimate.faces, start=1)
        ),
        ("optimisation", estimate.status),
        *(
            (f"   {name.replace('_', ' ')}, nats", f"{value:.1f}")
            for name, value in estimate.terms.items()
        ),
        ("seconds", f"{sum(result.seconds.values()):.1f}"),
    ]
