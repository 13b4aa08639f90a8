"""An estimate of a rendered person in the sun, kept as the studio does, and taken apart."""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from tempfile import mkdtemp

from PIL import Image

from skylight.estimation._summary import PhotoEstimate
from skylight.studio.tasks._portrait import FILE, command_of, keep_person, take_apart
from tests.sunny_face import sky_estimate, sunny_face

PHOTO = "someone's photo.png"


@dataclass(frozen=True, kw_only=True)
class Apart:
    """``folder`` is that of the estimate's job, ``file`` what the page gets."""

    result: PhotoEstimate
    folder: Path
    photo: Path
    file: Path


@lru_cache(maxsize=1)
def apart() -> Apart:
    """With the sun at (40, 50) degrees of azimuth and zenith angle."""
    folder = Path(mkdtemp())
    (folder / "files").mkdir()
    photo = folder / PHOTO
    Image.fromarray(sunny_face(40.0, 50.0).encoded).save(photo)
    result = replace(sky_estimate(), names=(str(photo),))
    keep_person(folder, result, command_of(PHOTO, "sunsky", 1, None))
    take_apart(str(photo), PHOTO, 10**7, str(folder), str(folder / "files"), tell=lambda *_: None)
    return Apart(result=result, folder=folder, photo=photo, file=folder / "files" / FILE)
