"""An estimate as the command leaves it, of a photograph whose EXIF data tell much."""

import json
from pathlib import Path
from typing import Any

from PIL import ExifTags, Image
from skimage.data import astronaut

from skylight.cli import main
from skylight.io._bounded import write_json

MAKER = "Private Camera Maker"
RESULTS = {
    "probe.exr",
    "probe.hdr",
    "probe.png",
    "posterior.exr",
    "mesh.obj",
    "estimate.json",
    "report.png",
    "person.safetensors",
}


def estimated(folder: Path, light: str = "sh9") -> tuple[Path, Path]:
    """(the photograph, the folder of its results); "sh9" is the quickest."""
    exif = Image.Exif()
    exif[ExifTags.Base.Make] = MAKER
    place = exif.get_ifd(ExifTags.IFD.GPSInfo)
    place[ExifTags.GPS.GPSLatitudeRef], place[ExifTags.GPS.GPSLatitude] = "N", (41.0, 53.0, 24.0)
    place[ExifTags.GPS.GPSLongitudeRef], place[ExifTags.GPS.GPSLongitude] = "E", (12.0, 29.0, 32.0)
    photo, results = folder / "portrait.jpg", folder / "portrait_light"
    Image.fromarray(astronaut()).save(photo, quality=95, exif=exif)
    options = ["--light", light, "--time", "2024-06-01T14:30+02:00", "--keep-place"]
    options += ["--detail", "none"]  # the map is the light alone, as the numbers tell it
    assert main(["estimate", str(photo), *options, "--out", str(results)]) == 0
    return photo, results


def rewrite(results: Path, **changed: Any) -> None:
    """Other values in estimate.json; of "posterior" and "verdict" those that are named."""
    path = results / "estimate.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    for name in ("posterior", "verdict"):
        changed[name] = content[name] | changed.get(name, {})
    write_json(path, content | changed)
