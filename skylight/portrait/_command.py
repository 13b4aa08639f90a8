"""``skylight relight-portrait``: a photographed or filmed person in another light."""

from __future__ import annotations

import sys
from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, get_args

import tyro
from tyro.conf import Positional

from skylight._names import (
    DEFAULT_LIGHT,
    PLAIN_READING,
    KeyName,
    LightName,
    MapReading,
    Place,
)
from skylight._options import take_care, who_works
from skylight.errors import InputError, SkylightError
from skylight.io._atomic import require_place
from skylight.work._device import Device
from skylight.work._progress import stage_bar

if TYPE_CHECKING:
    from skylight.estimation._kept import KeptFace
    from skylight.estimation._settings import EstimateSettings
    from skylight.portrait._asked import AskedLight

Decoding = tyro.conf.create_mutex_group(required=False)
Width = tyro.conf.create_mutex_group(required=False)
KEY_NAMES: tuple[KeyName, ...] = get_args(KeyName)
KeyChoice = Literal[KeyName, "all"]
ESTIMATED, OF_FILM = "estimate.json", "film.json"


def relight_portrait(
    photo: Positional[Path],
    key: tyro.conf.UseAppendAction[tuple[KeyChoice, ...]] = (),
    angle: tyro.conf.UseAppendAction[tuple[str, ...]] = (),
    soft: Annotated[bool, Width] = False,
    hard: Annotated[bool, Width] = False,
    size: Annotated[float | None, Width] = None,
    strength: float | None = None,
    under: Path | None = None,
    turn: float | None = None,
    sun: str | None = None,
    ev: float = 0.0,
    light: LightName = DEFAULT_LIGHT,
    model: Path | None = None,
    network: str | None = None,
    place: Place = "auto",
    face: int = 1,
    device: Device = "auto",
    out: Path | None = None,
    gamma: Annotated[float | None, Decoding] = None,
    linear: Annotated[bool, Decoding] = False,
    workers: int = 0,
    retry_failed: bool = False,
    reading: Annotated[MapReading, tyro.conf.OmitArgPrefixes] = PLAIN_READING,
) -> None:
    """Show a photographed person in another light: a key light, a map's, or the one found, turned.

    The light of the photograph is estimated as `skylight estimate` does; then skin
    gets the new light's shading, shadows and specular reflection in place of the old one's, hair
    and clothes their ratio, and what lies behind the ratio of the lights on upright surfaces.
    docs/portraits.md tells where that ends. A picture whose light could not be relied on says so
    below itself.

    Several lights are several pictures: --key left --key right, or --key all. The folder that
    `skylight estimate` made of a photograph takes the place of that: nothing is estimated again,
    which is a matter of seconds. Of a folder of photographs each is estimated, into
    OUT/estimates, and relit; of a folder of estimates each is relit. OUT/manifest.jsonl has a
    line for each that is finished, and the same command again goes on. What fails is passed over
    and listed at the end, and the exit code is 0 unless all failed.

    Of a film (mp4, mov, ...) the light is estimated once, into FILM_light beside what is written,
    as `skylight estimate FILM --video` does, and every frame is relit by it, steadily. That folder
    may be named in the film's place, for another key. There is no sound in what is written.

    Args:
        photo: Picture of a face: JPEG, PNG, TIFF, HEIC, EXR, Radiance HDR or RAW; a film of one;
            or a folder of an estimate, of estimates, or of pictures.
        key: One key light over a dim, even fill: from the left or right of whoever
            looks at the picture, from the top, from behind (rim), from the front; or all of these.
        angle: A key light at AZ,EL: degrees from the camera towards the viewer's right (180 is
            behind the sitter), and above the camera. May be given several times.
        soft: A wide key light, 40 degrees across, as a softbox nearby; 25 by default.
        hard: A narrow one, 5 degrees across, as a bare bulb.
        size: Its width in degrees.
        strength: Of the key light: how many times as bright as the fill it makes what faces it; 4
            by default. 0 leaves the fill.
        under: Lat-long map of the new light (.exr, .hdr), whose centre is where the camera looks.
            Its units do not matter: the face stays as bright as it was.
        turn: Turn the light that was found about the vertical by so many degrees; positive ones
            move what is ahead to the right.
        sun: Gives way to --angle. Move the sun that was found, or the main lamp, to AZ,EL: degrees
            from where the camera looks, ahead of it, towards its right, and above the horizon.
            With it --strength is its irradiance as a multiple of a horizontal surface's by all
            other light.
        ev: Exposure of the result in stops more.
        light: Light model of the estimate, as for `skylight estimate`.
        model: Folder of a trained model of your own, as for `skylight estimate`.
        network: Class of that model's network, where it is yours, as module:Class.
        place: Where the photograph was taken, as for `skylight estimate`.
        face: Whose: faces are counted from 1, the largest.
        device: Where light is traced and optimised.
        out: The picture: .png (8-bit sRGB) or .exr (linear, in the photograph's units); of a film,
            .mp4, or .mkv without loss; or a folder for several. By default PHOTO's name with the
            light's, as me_left.png, in the current folder; of a folder, its name with _relit.
        gamma: The picture's values are light to the power of 1/GAMMA, instead of sRGB.
        linear: The picture's values are proportional to light, instead of sRGB.
        workers: Of a folder: processes that work at the same time; 0 for one per core.
        retry_failed: Of a folder of pictures: estimate those again that failed before.
        reading: How the map of --under is read.
    """
    keys: list[KeyName] = [name for name in KEY_NAMES if name in key or "all" in key]
    kinds = {
        "--key": bool(key),
        "--angle": bool(angle),
        "--under": under is not None,
        "--turn": turn is not None,
        "--sun": sun is not None,
    }
    given = [option for option, is_given in kinds.items() if is_given]
    if not given:
        raise InputError(
            f"name the light: --key {', '.join(KEY_NAMES)} or all, --angle AZ,EL, "
            "--turn DEGREES or --under MAP"
        )
    of_keys = given[0] in ("--key", "--angle")
    if len(given) > 1 and given != ["--key", "--angle"]:
        raise InputError(f"{given[0]} and {given[-1]} contradict each other: name one of them")
    if not of_keys and (soft or hard or size is not None):
        width = "--soft" if soft else "--hard" if hard else "--size"
        raise InputError(f"{width} is a key light's: it goes with --key or --angle")
    if strength is not None and not of_keys and sun is None:
        raise InputError("--strength is a key light's: it goes with --key or --angle")
    if not -16 <= ev <= 16:
        raise InputError(f"--ev lies between -16 and 16 stops, got {ev:g}")
    from skylight.portrait._asked import (
        angles_of,
        asked_keys,
        asked_map,
        asked_sun,
        asked_turn,
    )
    from skylight.portrait._keys import HARD_DEG, SOFT_DEG

    if sun is not None:
        there = angles_of(sun, "--sun")
        azimuth = (360.0 - there[0]) % 360.0 - 180.0
        take_care(
            "--sun counts from ahead of the camera, behind the sitter, and goes with the next "
            f"version: --angle={azimuth:g},{there[1]:g} puts a key light there (0 at the camera)"
        )
        lights = [asked_sun(there, strength)]
    elif under is not None:
        lights = [asked_map(under, reading)]
    elif turn is not None:
        lights = [asked_turn(turn)]
    else:
        size = SOFT_DEG if soft else HARD_DEG if hard else size
        places = [angles_of(each, "--angle") for each in angle]
        lights = asked_keys(keys, places, size, strength)
    from skylight.estimation._settings import EstimateSettings
    from skylight.models._bundle import own_model

    settings = EstimateSettings(
        light=light,
        model=own_model(model, network),
        place=place,
        face=face,
        device=device,
        decode="linear" if linear else gamma,
    )
    wanted = _Wanted(photo=photo, lights=lights, exposure=2.0**ev, out=out, settings=settings)
    from skylight.imaging._film import FILM_SUFFIXES

    is_estimate, of_film = ((photo / name).is_file() for name in (ESTIMATED, OF_FILM))
    is_film = of_film or (photo.suffix.lower() in FILM_SUFFIXES and not photo.is_dir())
    if photo.is_dir() and not is_estimate and not is_film:
        _relight_folder(wanted, workers, retry_failed)
        return
    if workers or retry_failed:
        raise InputError(
            f"{'--workers' if workers else '--retry-failed'} is for a folder of pictures or "
            f"estimates, and {photo} is none"
        )
    if is_film:
        _relight_film(wanted, is_estimate=of_film)
    else:
        _relight_one(wanted, is_estimate=is_estimate)


@dataclass(frozen=True, kw_only=True)
class _Wanted:
    """What a command line asks for."""

    photo: Path
    lights: list[AskedLight]
    exposure: float
    out: Path | None
    settings: EstimateSettings
    suffixes: tuple[str, str] = (".png", ".exr")  # of what is written, the usual one first

    @property
    def endings(self) -> str:
        return f"a {self.suffixes[0]} or {self.suffixes[1]}"

    def refuse_settings(self) -> None:
        """What was estimated is not estimated otherwise."""
        chosen, usual = self.settings, type(self.settings)()
        for name, option in {
            "light": "--light",
            "model": "--model",
            "place": "--place",
            "face": "--face",
            "decode": "--gamma or --linear",
        }.items():
            if getattr(chosen, name) != getattr(usual, name):
                raise InputError(
                    f"{option}: the light of {self.photo} is estimated already; leave it out, or "
                    "name what it was estimated of"
                )

    def pictures(self, stem: str) -> dict[Path, AskedLight]:
        """Where each light's goes, for one photograph or film."""
        out, usual = self.out, self.suffixes[0]
        named = {f"{stem}_{each.name}{usual}": each for each in self.lights}
        if out is None:
            return {Path(name): each for name, each in named.items()}
        if out.suffix == "" or out.is_dir():
            return {out / name: each for name, each in named.items()}
        if out.suffix.lower() not in self.suffixes:
            raise InputError(f"{out}: write {self.endings}, or into a folder")
        if len(named) > 1:
            raise InputError(
                f"{out}: {len(named)} lights are as many pictures: name a folder for them"
            )
        return {out: self.lights[0]}

    def make_places(self, pictures: Collection[Path]) -> None:
        """A folder for the pictures where one is asked for; or see that each has its place."""
        if self.out is not None and self.out not in pictures:
            if self.out.is_file():
                raise InputError(f"{self.out} is a file: name a folder, {self.endings}")
            require_place(self.out.resolve().parent / "picture.png")
            self.out.mkdir(exist_ok=True)
        for path in pictures:
            require_place(path)


def _relight_one(wanted: _Wanted, *, is_estimate: bool) -> None:
    from skylight.estimation._kept import KeptFace, read_face
    from skylight.estimation._photos import Pictures
    from skylight.portrait._asked import written_pictures

    photo = wanted.photo
    kept: KeptFace | None = None
    if is_estimate:
        wanted.refuse_settings()
        kept = read_face(photo)
    pictures = wanted.pictures(photo.resolve().stem if kept is None else Path(kept.name).stem)
    file = photo if kept is None else kept.file
    for path in pictures:
        if file is not None and path.resolve() == file.resolve():
            raise InputError(f"{path} is the photograph itself: name another picture")
    wanted.make_places(pictures)
    with stage_bar() as progress:
        if kept is None:
            found = Pictures.of([photo], wanted.settings, progress=progress).estimate()
            kept = KeptFace.of(found)
        notes, lines = list(kept.advice), [f"verdict     {kept.verdict}"]
        made = written_pictures(
            kept,
            pictures,
            exposure=wanted.exposure,
            progress=lambda share: progress("relighting", share),
        )
        for (path, light), relit in zip(pictures.items(), made, strict=True):
            notes += [note for note in (relit.warning, *relit.notes) if note]
            if light.keep == "brightness":
                lines.append(f"exposure    the map's light times {relit.exposure:.3g}")
            lines.append(str(path))
    for note in dict.fromkeys(notes):
        take_care(note)
    print("\n".join(lines))


def _relight_film(wanted: _Wanted, *, is_estimate: bool) -> None:
    from skylight.estimation.film._estimate import FilmSettings
    from skylight.estimation.film._kept import read_film
    from skylight.estimation.film._results import relightable
    from skylight.imaging._film import require_film
    from skylight.imaging._film_writer import CODES
    from skylight.portrait._film import relight_film

    usual, lossless = CODES
    wanted = replace(wanted, suffixes=(usual, lossless))
    film, folder, kept = wanted.photo, wanted.photo, None
    if is_estimate:
        wanted.refuse_settings()
        kept = read_film(folder)
        film = kept.file
    else:
        require_film(film)
        # beside what is written, where skylight estimate would put it
        folder = Path(f"{film.resolve().stem}_light")
    films = wanted.pictures(film.resolve().stem)
    for path in films:
        if path.resolve() == film.resolve():
            raise InputError(f"{path} is the film itself: name another one")
    wanted.make_places(films)
    if not is_estimate:
        folder = next(iter(films)).parent / folder
    try:
        with stage_bar() as progress:
            if kept is None:
                settings = FilmSettings(estimate=wanted.settings)
                kept = relightable(folder, film, settings, progress)
            made = {path: light.make(kept) for path, light in films.items()}
            notes = relight_film(
                kept,
                made,
                keep=wanted.lights[0].keep,
                exposure=wanted.exposure,
                progress=progress,
            )
    except KeyboardInterrupt:
        raise SkylightError(
            "interrupted; no film is left half written, and the same command goes on with the "
            f"light in {folder}"
        ) from None
    for note in dict.fromkeys([*notes, *(note for one in made.values() for note in one.notes)]):
        take_care(note)
    print(f"verdict     {kept.verdict}")
    if not is_estimate:
        print(f"light       {folder}, which can be named for another key")
    for path in films:
        print(path)


def _relight_folder(wanted: _Wanted, workers: int, retry_failed: bool) -> None:
    from skylight.estimation._folder import estimate_folder
    from skylight.estimation._manifest import MANIFEST, left_out
    from skylight.portrait._folder import ESTIMATES, estimates_below, relight_folder

    photos = wanted.photo
    out = wanted.out or Path(f"{photos.resolve().name}_relit")
    if out.suffix.lower() in (".png", ".exr"):
        raise InputError(f"{out}: {photos} is a folder, whose pictures go into another: name one")
    if out.resolve() == photos.resolve():
        raise InputError(f"{out}: relit pictures go to another folder: name one")
    who, failed = who_works(workers, None, out), []
    estimates = photos / ESTIMATES if (photos / ESTIMATES / MANIFEST).is_file() else photos
    try:
        with stage_bar() as progress:
            if (estimates / MANIFEST).is_file() or not _has_photos(photos, out):
                wanted.refuse_settings()
                if not estimates_below(estimates):
                    raise InputError(f"{photos}: neither pictures nor estimates in this folder")
            else:
                if others := left_out(photos, out):
                    take_care(f"{photos}: left out, as no pictures known here: {others}")
                estimates = out / ESTIMATES
                found = estimate_folder(
                    photos,
                    estimates,
                    wanted.settings,
                    workers=who,
                    retry_failed=retry_failed,
                    progress=progress,
                )
                failed = [entry for entry in found if entry.status == "failed"]
            entries = []
            if estimates_below(estimates):
                entries = relight_folder(
                    estimates,
                    out,
                    wanted.lights,
                    exposure=wanted.exposure,
                    workers=who,
                    progress=progress,
                )
    except KeyboardInterrupt:
        raise SkylightError(
            f"interrupted; what {out / MANIFEST} lists is done, and the same command goes on"
        ) from None
    count = len(entries) + len(failed)
    failed += [entry for entry in entries if entry.status == "failed"]
    for entry in failed:
        print(f"skylight: failed: {entry.error}", file=sys.stderr)
    if len(failed) == count:
        raise InputError(f"none of {count} portraits could be relit: see the lines above")
    lit = f"{len(wanted.lights)} lights" if len(wanted.lights) > 1 else "one light"
    print(f"{out}: {count - len(failed)} of {count} portraits in {lit}, see {MANIFEST}")


def _has_photos(folder: Path, out: Path) -> bool:
    from skylight.estimation._manifest import list_photos

    try:
        return bool(list_photos(folder, out))
    except InputError:
        return False
