"""The files of a film's light: probes, numbers, and a figure over time."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from skylight._figures import (
    ACCENT,
    MUTED,
    STYLE,
    angles_deg,
    named_angles,
    save,
    show,
    show_probe,
    white_of,
)
from skylight.errors import InputError
from skylight.estimation._report import SOME_FILES, write_mesh
from skylight.estimation._summary import (
    at,
    describe_lights,
    describe_posterior,
    describe_verdict,
    draw_region,
    posterior_map,
    probe_title,
    told_verdict,
)
from skylight.estimation.film._estimate import (
    FOLLOWING,
    FilmEstimate,
    FilmSettings,
    estimate_film,
)
from skylight.estimation.film._kept import KEPT_FILM, KeptFilm, read_film, write_film
from skylight.estimation.film._light import FrameLight
from skylight.imaging._photo import read_photo
from skylight.imaging._preview import write_probe
from skylight.io._bounded import write_json
from skylight.io._files import write_environment_map
from skylight.work._progress import StageProgress
from skylight.work._resumable import SETTINGS, keep_settings, locked, results_folder

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ABREAST = 6


def probe_name(number: int) -> str:
    """Of keyframe ``number``, counted from 0."""
    return f"probe_{number:03d}.exr"


def write_film_results(folder: Path, result: FilmEstimate, *, source: str) -> None:
    """probe.exr, probe.hdr, posterior.exr, probe_000.exr ..., mesh.obj, film.json, report.png.

    ``probe`` is the film's, the others each keyframe's; all are in the world's frame, which is the
    camera's at the first frame.
    """
    light, content = result.light, describe_film(result, source=source)
    maps = {"posterior.exr": posterior_map(light.start.posterior)}
    maps |= {probe_name(number): frame.environment for number, frame in enumerate(light.frames)}
    write_mesh(folder / "mesh.obj", result.fits[0])
    write_film_report(folder / "report.png", result, title=Path(source).name)
    write_json(folder / "film.json", content)
    write_probe(folder, light.mean.environment)
    for name, environment in maps.items():
        write_environment_map(folder / name, environment)


def estimate_film_into(
    out: Path, film: Path, settings: FilmSettings, progress: StageProgress
) -> FilmEstimate:
    """The light of a film (or of a folder of its frames), and its files in ``out``.

    Raises
    ------
    InputError
        As :func:`estimate_film`; ``out`` was made with other settings or of another film, or
        another run is at work there.
    """
    with locked(out, out / FOLLOWING):
        keep_settings(out / SETTINGS, settings.facts(film))
        result = estimate_film(film, out, settings, progress)
        with results_folder(out, SOME_FILES) as folder:
            write_film_results(folder, result, source=str(film))
            if film.is_file():
                face, decode = settings.estimate.face, settings.estimate.decode
                assert isinstance(face, int)
                write_film(folder, KeptFilm.of(result, film, decode, face))
    return result


def relightable(out: Path, film: Path, settings: FilmSettings, progress: StageProgress) -> KeptFilm:
    """What portraits are relit by, of an earlier estimate in ``out`` or of one made now.

    Raises
    ------
    InputError
        As :func:`estimate_film_into` and :func:`read_film`; ``out`` is of a photograph.
    """
    if (out / "estimate.json").is_file():
        raise InputError(f"{out} holds the light of a photograph: write elsewhere with --out")
    if (out / SETTINGS).is_file():
        try:
            keep_settings(out / SETTINGS, settings.facts(film))
        except InputError as error:
            raise InputError(
                f"{out}: the light in it is that of another film or other options; name {out} in "
                "the film's place to relight by it, delete it, or write elsewhere with --out"
            ) from error
    if not ((out / KEPT_FILM).is_file() and (out / SETTINGS).is_file()):
        estimate_film_into(out, film, settings, progress)
    return read_film(out)


def describe_film(result: FilmEstimate, *, source: str) -> dict[str, object]:
    """What film.json holds."""
    light, shot = result.light, result.followed.shot
    return {
        "source": source,
        "light": light.start.light,
        "frame": "the world's: the first frame's camera, taken to be level, looks along -Z, the "
        "centre of the maps; +X is the picture's right, +Y up; azimuth from -Z towards +X, zenith "
        "from +Y; linear Rec.709",
        "sun": named_angles(light.mean.sun_direction),
        "verdict": describe_verdict(light.start.verdict),
        "posterior": describe_posterior(light.start.posterior),
        "lights": describe_lights(
            replace(light.start, environment=light.mean.environment, lamps=light.mean.lamps)
        ),
        "params": light.mean.params.tolist(),
        "ground_albedo": light.ground_albedo.tolist(),
        "albedo": light.albedo.tolist(),
        "gloss": light.specular_scale,
        "drift_per_s": light.drift_per_s,
        "noise": light.noise,
        "focal_length_px": result.fits[0].camera.focal_px,
        "size": list(result.followed.size),
        "frames_followed": result.followed.frames,
        "seconds": [shot.begin_s, shot.end_s],
        "gaps": [list(gap) for gap in shot.gaps],
        "advice": list(result.advice),
        "keyframes": [
            {
                "time_s": frame.time_s,
                "frame": keyframe.number,
                "probe": probe_name(number),
                "sun": named_angles(frame.sun_direction),
                "azimuth_spread_deg": _degrees(frame.azimuth_spread_rad),
                "exposure": frame.exposure,
                "white_balance": frame.white_balance.tolist(),
                "edit": asdict(frame.edit),
                "residual": frame.residual,
                "params": frame.params.tolist(),
                "world_from_camera": turn.tolist(),
                "facing_angle_deg": float(np.degrees(fit.facing_angle_rad)),
                "landmark_error": fit.landmark_error,
            }
            for number, (frame, keyframe, fit, turn) in enumerate(
                zip(
                    light.frames,
                    result.keyframes,
                    result.fits,
                    result.world_from_camera,
                    strict=True,
                )
            )
        ],
    }


def film_summary(result: FilmEstimate) -> str:
    """A few lines for the terminal."""
    light, followed = result.light, result.followed
    apart = _apart_deg(light.frames)
    return "\n".join(
        [
            f"film        {followed.frames} frames followed, {len(light.frames)} keyframes from "
            f"{light.frames[0].time_s:.1f} to {light.frames[-1].time_s:.1f} s",
            *told_verdict(light.start.verdict),
            f"brightest   {at(light.mean.sun_direction)}",
            f"steadiness  within {apart:.1f}° of its mean over the film",
        ]
    )


def write_film_report(path: Path, result: FilmEstimate, *, title: str) -> None:
    """A PNG: some keyframes, the film's probe, and the sun and the camera over time."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    light = result.light
    notes = [f"Take care: {line}" for line in result.advice]
    with rc_context(STYLE):
        figure = Figure(figsize=(16.0, 9.0), dpi=120, facecolor="white")
        figure.text(0.02, 0.955, f"Light of {title}", fontsize=17, fontweight="bold")
        for number, note in enumerate(notes[:4]):
            figure.text(0.02, 0.93 - 0.022 * number, note, color=ACCENT, fontsize=9.5)
        grid = figure.add_gridspec(
            3, ABREAST, top=0.83, bottom=0.08, left=0.06, right=0.98, hspace=0.4, wspace=0.35
        )
        axes = figure.add_subplot(grid[1:, :3])
        environment, posterior = light.mean.environment, light.start.posterior
        show_probe(
            axes,
            environment,
            probe_title(posterior, light.start.verdict),
            white=white_of(environment.flat),
        )
        draw_region(axes, posterior, environment.layout[0])
        _over_time(figure.add_subplot(grid[1:, 3:]), result)
        chosen = np.unique(np.linspace(0, len(light.frames) - 1, ABREAST).round().astype(int))
        for column, k in enumerate(chosen):
            axes = figure.add_subplot(grid[0, column])
            picture = result.keyframes[k].picture
            assert isinstance(picture, Path)
            show(axes, read_photo(picture).encoded, f"{light.frames[k].time_s:.1f} s")
        save(figure, path)


def _over_time(axes: "Axes", result: FilmEstimate) -> None:
    frames = result.light.frames
    times = [frame.time_s for frame in frames]
    angles = np.array([angles_deg(frame.sun_direction) for frame in frames])
    azimuth = np.degrees(np.unwrap(np.radians(angles[:, 0])))
    spread = np.degrees([frame.azimuth_spread_rad or 0.0 for frame in frames])
    pans = [np.degrees(np.arctan2(-turn[0, 2], turn[2, 2])) for turn in result.world_from_camera]
    axes.fill_between(times, azimuth - spread, azimuth + spread, color=ACCENT, alpha=0.2, lw=0)
    axes.plot(times, azimuth, color=ACCENT, marker="o", ms=3, label="sun's azimuth, in the world")
    axes.plot(times, angles[:, 1], color="black", marker="o", ms=3, label="sun's zenith angle")
    axes.plot(times, pans, color=MUTED, ls="--", label="where the camera looks")
    axes.set_xlabel("time in the film, s")
    axes.set_ylabel("degrees")
    axes.legend(frameon=False)


def _apart_deg(frames: tuple[FrameLight, ...]) -> float:
    """Median angle of the keyframes' suns to their mean direction."""
    suns = np.array([frame.sun_direction.numpy() for frame in frames])
    mean = suns.mean(0) / np.linalg.norm(suns.mean(0))
    return float(np.degrees(np.median(np.arccos(np.clip(suns @ mean, -1, 1)))))


def _degrees(angle_rad: float | None) -> float | None:
    return None if angle_rad is None else float(np.degrees(angle_rad))
