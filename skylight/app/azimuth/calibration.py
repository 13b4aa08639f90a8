"""Azimuths of the light probes in a folder of captures: candidates, and the choice of a person.

In two steps, as in the thesis (5.4.2): errors of the relit face for all azimuths, then one of
their local minima chosen by eye, since a face lit from the left by a low sun may look much like
one lit by bright clouds further back.
"""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from skylight.app.azimuth.pictures import write_choice
from skylight.errors import InputError, OutputError
from skylight.faces.captures import (
    CAPTURES_NAME,
    FaceCapture,
    capture_hash,
    read_captures,
    read_probe,
    write_azimuths,
)
from skylight.faces.detection.landmarkers import choose_landmarker
from skylight.faces.landmarks import choose_face
from skylight.faces.model import HeadModel
from skylight.faces.observe import FaceView, observe_face
from skylight.faces.photographs import fit_visible
from skylight.imaging.photo import Photo, read_photo
from skylight.inverse.azimuth import azimuth_curve
from skylight.io.bounded import json_content
from skylight.io.json_files import write_json
from skylight.work.progress import CountProgress

FOLDER = "azimuth"  # within the folder of captures
FACE_HEIGHT_PX = 64  # as many pixels as tell shading; half of an estimate's rays


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """A photograph's local minima, best first; ``hash`` names the files they are of."""

    hash: str
    azimuths_deg: tuple[float, ...]
    errors: tuple[float, ...]


def propose(
    data: Path, progress: CountProgress | None = None
) -> tuple[dict[str, Proposal], dict[str, str]]:
    """Minima for all captures without an azimuth, and why others have none, by photograph.

    For each, ``data/azimuth/PHOTO.png`` shows what there is to choose from, and ``PHOTO.json``
    keeps it: what was done is not done again unless photograph or probe changed.

    Raises
    ------
    InputError
        No usable ``captures.csv``.
    OutputError
        The pictures cannot be written.
    """
    captures = [c for c in read_captures(data) if c.azimuth_deg is None]
    tell = progress or (lambda done, total: None)
    proposals: dict[str, Proposal] = {}
    problems: dict[str, str] = {}
    for done, capture in enumerate(captures):
        tell(done, len(captures))
        try:
            proposals[capture.photo] = _remembered(data, capture) or _proposal(data, capture)
        except InputError as error:
            problems[capture.photo] = str(error)
    return proposals, problems


def choose(data: Path, numbers: Mapping[str, int]) -> dict[str, float]:
    """Write the chosen minima, counted from 1, into ``captures.csv``; all of them or none.

    Raises
    ------
    InputError
        A photograph that is not in the table, has no proposal or changed since, or a number
        that it does not have.
    """
    captures = {capture.photo: capture for capture in read_captures(data)}
    azimuths = {}
    for photo, number in numbers.items():
        if photo not in captures:
            raise InputError(f"{data / CAPTURES_NAME}: no photograph {photo} there")
        proposal = _remembered(data, captures[photo])
        if proposal is None:
            raise InputError(
                f"{photo}: nothing to choose from yet, or it changed since; run `skylight faces "
                f"calibrate-azimuth {data}` with its azimuth_deg empty and look at its picture"
            )
        if not 1 <= number <= len(proposal.azimuths_deg):
            raise InputError(
                f"{photo}: there is no minimum {number}; choose 1 to {len(proposal.azimuths_deg)}"
            )
        azimuths[photo] = proposal.azimuths_deg[number - 1]
    write_azimuths(data, azimuths)
    return azimuths


def parse_choices(texts: Iterable[str]) -> dict[str, int]:
    """{photograph: number} of "PHOTO=N"."""
    numbers: dict[str, int] = {}
    for text in texts:
        photo, _, number = text.rpartition("=")
        if not photo or not number.isdecimal():
            raise InputError(f"--choose takes PHOTO=N, such as anna.jpg=2; got {text!r}")
        if photo in numbers:
            raise InputError(f"--choose names {photo} twice; leave one of them")
        numbers[photo] = int(number)
    return numbers


def picture_path(data: Path, photo: str) -> Path:
    return data / FOLDER / f"{photo}.png"


def _record_path(data: Path, photo: str) -> Path:
    return data / FOLDER / f"{photo}.json"


def _remembered(data: Path, capture: FaceCapture) -> Proposal | None:
    """The proposal of an earlier run; None without one, or where the files are others now."""
    path = _record_path(data, capture.photo)
    if not path.is_file() or not picture_path(data, capture.photo).is_file():
        return None
    try:
        content = json_content(path)
        proposal = Proposal(
            hash=content["hash"],
            azimuths_deg=tuple(map(float, content["azimuths_deg"])),
            errors=tuple(map(float, content["errors"])),
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); delete it and run again") from error
    return proposal if proposal.hash == capture_hash(data, capture) else None


def _proposal(data: Path, capture: FaceCapture) -> Proposal:
    """Measure, draw, remember."""
    named = capture_hash(data, capture)
    probe = read_probe(data, capture)
    photo = read_photo(data / capture.photo, require_colour=True)
    view = _view(photo, str(data / capture.photo))
    curve = azimuth_curve(view.observation, probe)
    proposal = Proposal(
        hash=named,
        azimuths_deg=tuple(float(curve.azimuth_deg[i]) for i in curve.minima),
        errors=tuple(float(curve.error[i]) for i in curve.minima),
    )
    picture = picture_path(data, capture.photo)
    try:
        picture.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write into {picture.parent}: {error.strerror}") from error
    write_choice(picture, capture.photo, photo, view, probe, curve)
    write_json(_record_path(data, capture.photo), asdict(proposal))
    return proposal


def _view(photo: Photo, source: str) -> FaceView:
    """The largest face with its transport."""
    model = HeadModel.load()
    face = choose_face(choose_landmarker().detect(photo.encoded), 1, source)
    fit = fit_visible(model, photo, face, source)
    return observe_face(photo.pixels, photo.clipped, model, fit, face_height_px=FACE_HEIGHT_PX)
