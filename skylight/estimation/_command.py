"""``skylight estimate``: illumination from photographs, folders and films of faces."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from tyro.conf import Positional

from skylight._names import (
    DEFAULT_DETAIL,
    DEFAULT_LIGHT,
    DetailName,
    HeadName,
    LandmarkerName,
    LightName,
    SolverName,
)
from skylight._options import kind_of_place, take_care, taken_by_hand, who_works
from skylight.errors import InputError, SkylightError
from skylight.work._device import Device
from skylight.work._progress import ProgressForm, stage_bar

if TYPE_CHECKING:
    from skylight.estimation._settings import EstimateSettings
    from skylight.imaging._capture_metadata import CaptureMetadata

Decoding = tyro.conf.create_mutex_group(required=False)


def estimate(
    photo: Positional[Path],
    more: Positional[tuple[Path, ...]] = (),
    shared_light: bool = False,
    light: LightName = DEFAULT_LIGHT,
    model: Path | None = None,
    network: str | None = None,
    solver: SolverName = "scan",
    face: int | None = None,
    faces: Literal["one", "all"] = "one",
    head: HeadName = "fitted",
    device: Device = "auto",
    out: Path | None = None,
    gamma: Annotated[float | None, Decoding] = None,
    linear: Annotated[bool, Decoding] = False,
    landmarks: LandmarkerName = "mediapipe",
    time: str | None = None,
    place: str | None = None,
    heading: float | None = None,
    ignore_exif_sun: bool = False,
    keep_place: bool = False,
    ground_albedo: str | None = None,
    detail: DetailName = DEFAULT_DETAIL,
    workers: int = 0,
    cluster: str | None = None,
    batch: int | None = None,
    retry_failed: bool = False,
    video: bool = False,
    keyframes: int = 24,
    rate: float = 30.0,
    progress: ProgressForm = "bar",
) -> None:
    """Recover the light in which a face was photographed, or several.

    Faces under one light tell more of it together: all of a picture with --faces all, those of
    several pictures with --shared-light. Every face has its own albedo, every picture its own
    exposure. Cameras are taken to be level and, of several pictures, to look the same way: a
    burst, a person who turns, a group that is photographed again.

    Writes probe.exr and probe.hdr (linear lat-long maps in the camera's frame, 256 x 512 pixels:
    the centre is where the camera looks, its right is the picture's right), probe.png (the same to
    look at), posterior.exr (how likely the sun stands where, per sr), mesh.obj (the
    fitted head; mesh_1.obj and so on where there are several), estimate.json (all numbers) and
    report.png (a picture of it all).

    Of a folder, each picture in it and in folders within is estimated by itself: a/me.jpg into
    OUT/a/me_jpg. OUT/manifest.jsonl has a line for each picture that is finished; the same
    command again goes on. A picture that fails is passed over and listed at the end, and the exit
    code is 0 unless all failed.

    Of a film, or of a folder of its frames, with --video: one person is followed, and the light
    stands still in the world, whatever head and camera do, or drifts slowly. Writes probe.exr,
    probe.hdr and probe.png, a probe_000.exr for each keyframe, all as seen from the first frame's
    camera, posterior.exr, mesh.obj, film.json and report.png. The same command again goes on.

    Args:
        photo: Picture of a face: JPEG, PNG, TIFF, HEIC, EXR, Radiance HDR or RAW; or a folder of
            such.
            Of a grey one the colour of the light is only what is usual.
        more: Further pictures in the same light; only with --shared-light.
        shared_light: All pictures were taken in one light by cameras that looked the same way.
        light: Light model: any place, all round (sphere); learnt skies (autoencoder); Preetham's
            sky with a sun; lamps in ambient light (rooms, studios, streets at night); spherical
            harmonics with 9 or 25 coefficients; or auto, the likelier of learnt skies and lamps,
            for half as much time again as skies alone. What only skies have (--model of skies,
            --solver thesis) makes the default learnt skies, and a line says so.
        model: Folder of a trained model of your own instead of the one that comes with skylight:
            of skies, for --light autoencoder, sunsky or auto, or of places, for sphere.
        network: Class of that model's network, where it is yours, as module:Class.
        solver: How --light autoencoder is searched for: from many starts where a scan finds the
            sun, or as in the thesis (B.1), from the mean sky on four levels.
        face: Which face of each picture, counted from 1, the largest; 1 unless said otherwise.
        faces: One face of each picture, or all.
        head: The morphable model's head as fitted to the landmarks, or deformed to meet them (only
            for landmarks that are exact to a millimetre).
        device: Where light is traced and optimised: on the CPU, by CUDA, or by CUDA where it is.
        out: Folder for the results; by default PHOTO's name with _light, in the current folder.
        gamma: The picture's values are light to the power of 1/GAMMA, instead of sRGB.
        linear: The picture's values are proportional to light, instead of sRGB.
        landmarks: What finds the face: MediaPipe's landmarker, or dlib's, an extra for research.
        time: When the (first) picture was taken, as 2024-06-01T14:30+02:00, instead of what its
            EXIF data tell. With the place it tells the sun's height.
        place: Where, as LAT,LON: degrees north and east (south and west are negative); or what kind
            of place: outdoors, indoors, or flash (on the camera), which rules out kinds of place
            for sphere, the light in place of auto then; or both, as outdoors,41.89,12.49.
        heading: Where the camera looked: degrees clockwise from true north.
        ignore_exif_sun: Do not use time, place and heading of the EXIF data.
        keep_place: Write time, place and heading into estimate.json; they are left out else.
        ground_albedo: The ground's albedo for skies and sphere, as R,G,B or R,G,B,SPREAD (linear,
            0 to 1; the spread is relative, 0.1 without it), or the file of `skylight probe ground`;
            by default what is usual of grounds.
        detail: What the map shows beside its light, which stays the same: none, photo (the
            picture's own pixels inside its view, without the person), or mirrored (its texture
            round the sphere too: invented, for reflections).
        workers: Of a folder: processes that work at the same time; 0 for one per core. Each takes
            up to 1 GB.
        cluster: Of a folder: a dask scheduler's address, whose workers do it instead.
        batch: Of a folder, for --light autoencoder, sunsky or auto: so many pictures are solved
            together on the device by one process, while the workers do the rest; by default 16 by
            CUDA, and 1 on the CPU, where each worker solves its own.
        retry_failed: Of a folder: try again the pictures that failed before.
        video: PHOTO is a film (mp4, mov, ...) of up to ten minutes, or a folder of its frames.
        keyframes: Of a film: estimate the light at so many frames at most.
        rate: Of a folder of a film's frames: so many are shown in a second.
        progress: A bar on a terminal; or, for programs that start this, lines of JSON on standard
            error, {"stage": "tracing light", "share": 0.25}.
    """
    if face is not None and faces == "all":
        raise InputError(f"--face {face} and --faces all contradict each other: leave one out")
    from skylight.estimation._settings import EstimateSettings
    from skylight.models._bundle import own_model
    from skylight.models._ground import KnownGround

    kind, place = kind_of_place(place)
    settings = EstimateSettings(
        light=light,
        model=own_model(model, network),
        solver=solver,
        face="all" if faces == "all" else 1 if face is None else face,
        head=head,
        decode="linear" if linear else gamma,
        landmarks=landmarks,
        ignore_exif_sun=ignore_exif_sun,
        ground=None if ground_albedo is None else KnownGround.parse(ground_albedo),
        place=kind,
        detail=detail,
        device=device,
    )
    taken = taken_by_hand(time, place, heading)
    together = shared_light or bool(more)
    of_folders = {
        "--workers": workers != 0,
        "--cluster": cluster is not None,
        "--batch": batch is not None,
        "--retry-failed": retry_failed,
    }
    if video:
        _refuse(
            {"--shared-light": together, "--time, --place and --heading": taken is not None}
            | of_folders,
            ": not for films, in which one face is followed by MediaPipe",
        )
        _estimate_film(photo, out, settings, keyframes, rate, progress)
    elif photo.is_dir():
        if taken is not None:
            raise InputError(
                f"{photo} is a folder, whose pictures were not all taken at one time and place: "
                "--time, --place and --heading are for a picture"
            )
        if together:
            raise InputError(
                f"{photo} is a folder, whose pictures are estimated one by one: name the pictures "
                "themselves to give them a shared light"
            )
        _estimate_folder(
            photo,
            out or Path(f"{photo.resolve().name}_light"),
            settings,
            keep_place=keep_place,
            workers=workers,
            cluster=cluster,
            batch=batch,
            retry_failed=retry_failed,
            progress=progress,
        )
    else:
        _refuse(of_folders, f" is for a folder of pictures, and {photo} is none")
        if more and not shared_light:
            raise InputError(
                f"{1 + len(more)} pictures: add --shared-light if they were taken in the same "
                "light by cameras that looked the same way, else estimate them one by one, or put "
                "them into a folder and name that"
            )
        _estimate_photos((photo, *more), out, settings, taken, keep_place, progress)


def _refuse(options: dict[str, bool], why: str) -> None:
    """The first of the options that was given."""
    for option, is_given in options.items():
        if is_given:
            raise InputError(f"{option}{why}")


def _estimate_photos(
    paths: tuple[Path, ...],
    out: Path | None,
    settings: EstimateSettings,
    taken: CaptureMetadata | None,
    keep_place: bool,
    progress: ProgressForm,
) -> None:
    from skylight.estimation._photos import Pictures
    from skylight.estimation._report import SOME_FILES, mesh_names, write_results
    from skylight.estimation._summary import summary
    from skylight.imaging._film import FILM_SUFFIXES
    from skylight.work._resumable import results_folder

    out = out or Path(f"{paths[0].stem}_light")
    if paths[0].suffix.lower() in FILM_SUFFIXES:
        raise InputError(f"{paths[0]} is a film: add --video")
    with stage_bar(progress) as tell:
        pictures = Pictures.of(paths, settings, taken=taken, progress=tell)
        _ = settings.landmarker  # refuses what cannot be used
        with results_folder(out, SOME_FILES) as folder:
            result = pictures.estimate()
            tell("writing the results", 0.0)
            write_results(folder, result, keep_place=keep_place)
    for advice in result.estimate.advice:
        take_care(advice)
    print(summary(result))
    meshes = ", ".join(mesh_names(result))
    files = f"probe.exr, probe.hdr, probe.png, posterior.exr, {meshes}, estimate.json, report.png"
    print(f"written into {out}: {files}")


def _estimate_film(
    film: Path,
    out: Path | None,
    settings: EstimateSettings,
    keyframes: int,
    rate: float,
    progress: ProgressForm,
) -> None:
    from skylight.estimation.film._estimate import FilmSettings
    from skylight.estimation.film._results import estimate_film_into, film_summary

    out = out or Path(f"{film.resolve().stem}_light")
    chosen = FilmSettings(estimate=settings, keyframes=keyframes, rate=rate)
    try:
        with stage_bar(progress) as tell:
            result = estimate_film_into(out, film, chosen, tell)
    except KeyboardInterrupt:
        raise SkylightError(f"interrupted; the same command goes on with {out}") from None
    for advice in result.advice:
        take_care(advice)
    print(film_summary(result))
    count = len(result.light.frames)
    files = f"probe.exr, probe.hdr, probe.png, {count} of keyframes, posterior.exr, mesh.obj"
    print(f"written into {out}: {files}, film.json, report.png")


def _estimate_folder(
    photos: Path,
    out: Path,
    settings: EstimateSettings,
    *,
    keep_place: bool,
    workers: int,
    cluster: str | None,
    batch: int | None,
    retry_failed: bool,
    progress: ProgressForm,
) -> None:
    from skylight.estimation._folder import estimate_folder
    from skylight.estimation._manifest import MANIFEST, left_out

    if others := left_out(photos, out):
        take_care(f"{photos}: left out, as no pictures known here: {others}")
    who = who_works(workers, cluster, out)
    try:
        with stage_bar(progress) as tell:
            entries = estimate_folder(
                photos,
                out,
                settings,
                keep_place=keep_place,
                workers=who,
                batch=batch,
                retry_failed=retry_failed,
                progress=tell,
            )
    except KeyboardInterrupt:
        raise SkylightError(
            f"interrupted; what {out / MANIFEST} lists is done, and the same command goes on"
        ) from None
    failed = [entry for entry in entries if entry.status == "failed"]
    for entry in failed:
        print(f"skylight: failed: {entry.error}", file=sys.stderr)
    if len(failed) == len(entries):
        raise InputError(f"no light from any of {len(entries)} pictures: see {out / MANIFEST}")
    print(f"{out}: {len(entries) - len(failed)} of {len(entries)} pictures done, see {MANIFEST}")
