"""Draws the gallery: photographs, the light found, and the same portraits in other light.

    python -m tools.draw_gallery --photos FOLDER --map MAP.exr

``FOLDER`` holds the photographs of :data:`SHOWN` and :data:`FAILED`, and an index.json that tells
each one's source and licence. Writes a strip for each into ``docs/images/gallery`` and the page
``docs/gallery.md``. A strip that is there already is not drawn again; the page is written anew.
With the strips of :data:`COVER` and :data:`RELIT` go ``cover.jpg``, the first pictures of one, and
``relit.jpg``, the photograph and the key lights of the other, for the README and for other pages.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import tyro
from jaxtyping import UInt8
from numpy import ndarray
from PIL import Image
from rich.progress import track

from skylight._figures import angles_deg
from skylight.estimation._kept import KeptFace
from skylight.estimation._photos import estimate_photo
from skylight.estimation._report import write_results
from skylight.estimation._summary import PhotoEstimate
from skylight.imaging._colour import tone_map
from skylight.io._atomic import atomic_path
from skylight.io._bounded import json_content
from skylight.maps._viewer import export_viewer
from skylight.portrait._files import relit_portrait, shown, taken_apart
from skylight.portrait._keys import SOFT_DEG, key_light
from skylight.portrait._lights import NewLight, light_of_map
from skylight.portrait._relit import Keep
from skylight.sphere._envmap import luminance
from skylight.transport._scene import evaluation_scene
from tests.studio.browser.pictures import finished
from tools.measured import kept
from tools.viewer_page import opened

SHOWN = (
    "inter020.jpg",
    "inter037.jpg",
    "inter041.jpg",
    "inter011.jpg",
    "inter009.jpg",
    "inter025.jpg",
    "inter045.jpg",
    "inter001.jpg",
    "inter066.jpg",
    "inter082.jpg",
    "inter062.jpg",
    "inter072.jpg",
)
FAILED = {
    "inter028.jpg": "Back light that the estimate cannot explain, and says so; hard shadows of the "
    "photograph stay in the skin.",
    "inter021.jpg": "Hair dapples the face. The fitted head has no hair, so its shadows stay in "
    "the skin wherever the new light comes from, and the light found explains them wrongly.",
    "inter050.jpg": "Glasses and a beard cast shadows that the head does not have, and the dark "
    "shape below the nose stays when its light has gone to the other side.",
}
COVER, RELIT = "inter001.jpg", "inter041.jpg"
HEIGHT, COVER_HEIGHT = 300, 480
SHARE = 0.2  # of the samples of light in objects, whose noise is not seen at that height
COLUMNS = (
    "the photograph",
    "the light found, and objects in it",
    "objects put into the picture by `skylight export viewer`",
    "with `--key left`",
    "with `--key right`",
    "with `--key top --soft`",
    "under a captured map",
)


@dataclass(frozen=True, kw_only=True)
class Options:
    """Draw the gallery and its page."""

    photos: Path
    """Folder of photographs with an index.json."""
    map: Path
    """Captured lat-long map of the last column."""
    out: Path = Path("docs")
    """Folder of the page; pictures go into images/gallery below it."""


def main(options: Options) -> None:
    sources = json.loads((options.photos / "index.json").read_text(encoding="utf-8"))
    folder = options.out / "images" / "gallery"
    folder.mkdir(parents=True, exist_ok=True)
    told = {}
    for name in track((*SHOWN, *FAILED), description="gallery"):
        strip = folder / name
        facts = strip.with_suffix(".json")
        if facts.exists() and json_content(facts)["columns"] != len(COLUMNS):
            facts.unlink()  # of an earlier form of the strips
        told[name] = kept(facts, lambda n=name, s=strip: draw(options.photos / n, options.map, s))
    page = _page(told, sources, options.map.name)
    with atomic_path(options.out / "gallery.md") as temporary:
        temporary.write_text(page, encoding="utf-8")


def draw(photo: Path, map_path: Path, strip: Path) -> dict[str, object]:
    """Write the strip; what the page says of it."""
    result = estimate_photo(photo)
    face, estimate = KeptFace.of(result), result.estimate
    pictures = [result.photos[0].encoded, _light(result), _objects(result, photo)]
    lights: list[tuple[NewLight, Keep]] = [
        (key_light(face, "left"), "place"),
        (key_light(face, "right"), "place"),
        (key_light(face, "top", size_deg=SOFT_DEG), "place"),
        (light_of_map(map_path), "brightness"),
    ]
    portrait = taken_apart(face)
    for light, keep in lights:
        pictures.append(shown(relit_portrait(face, light, keep=keep, portrait=portrait)))
    _write_row(pictures, strip, HEIGHT)
    if strip.name == COVER:
        _write_row(pictures[:3], strip.with_name("cover.jpg"), COVER_HEIGHT)
    if strip.name == RELIT:
        _write_row([pictures[0], *pictures[3:6]], strip.with_name("relit.jpg"), HEIGHT)
    azimuth, zenith = angles_deg(estimate.sun_direction)
    return {
        "columns": len(COLUMNS),
        "light": estimate.light,
        "verdict": estimate.verdict.summary,
        "notes": list(portrait.doubts),
        "azimuth_deg": azimuth,
        "elevation_deg": 90 - zenith,
    }


def _light(result: PhotoEstimate) -> UInt8[ndarray, "h w 3"]:
    """The panorama above a scene of objects, each exposed by itself."""
    environment, scene = result.estimate.environment, evaluation_scene(144, 32)  # comes with it
    mean = float(luminance(scene.shade(environment)).mean())
    above = tone_map(environment.radiance, white=3 * mean)
    below = tone_map(scene.relight(environment), white=2 * mean)
    width = below.shape[1]
    above = cv2.resize(above, (width, width // 2), interpolation=cv2.INTER_AREA)
    return np.vstack([above, below])


def _objects(result: PhotoEstimate, photo: Path) -> UInt8[ndarray, "h w 3"]:
    """The photograph with the objects that the viewer's page begins with."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        write_results(folder, result)
        export_viewer(folder, folder / "page.html", photo=photo)
        with opened(folder / "page.html") as page:
            return finished(page, SHARE)[..., :3].astype(np.uint8)


def _write_row(pictures: list[UInt8[ndarray, "h w 3"]], path: Path, height: int) -> None:
    row = np.hstack([_sized(picture, height) for picture in pictures])
    with atomic_path(path) as temporary:
        Image.fromarray(row).save(temporary, format="JPEG", quality=85)


def _sized(picture: UInt8[ndarray, "h w 3"], height: int) -> UInt8[ndarray, "height w 3"]:
    width = round(picture.shape[1] * height / picture.shape[0])
    how = cv2.INTER_AREA if height < picture.shape[0] else cv2.INTER_CUBIC
    return cv2.resize(picture, (width, height), interpolation=how)


def _page(told: dict[str, dict], sources: dict[str, dict], map_name: str) -> str:
    lines = [
        "# Gallery",
        "",
        "Photographs that skylight had never seen, the light that it found in each, and the "
        "portraits [relit](portraits.md). They were chosen for their kinds of light, those at the "
        "end for how they fail; nothing was retouched. Where a verdict says *unknown* or "
        "*unreliable*, believe it. From left to right: " + "; ".join(COLUMNS) + f" (`{map_name}`).",
    ]
    for name in SHOWN:
        lines += ["", *_entry(name, told[name], sources[name])]
    lines += ["", "## Where it fails"]
    for name, why in FAILED.items():
        lines += ["", *_entry(name, told[name], sources[name]), "", why]
    lines += ["", "`python -m tools.draw_gallery --photos FOLDER --map MAP` draws this page."]
    return "\n".join(lines) + "\n"


def _entry(name: str, facts: dict, source: dict) -> list[str]:
    side = "ahead" if abs(facts["azimuth_deg"]) < 22.5 else f"at {facts['azimuth_deg']:+.0f}°"
    height = facts["elevation_deg"]
    light = f"{facts['light']}: {facts['verdict']}; brightest {side}, {height:.0f}° high"
    credit = f"[source]({source['original']}), CC0" if source["original"] else "public domain"
    alt = "portrait, light, objects, relit portraits"
    notes = "".join(f" In other light: {note}." for note in facts["notes"])
    return [f"![{alt}](images/gallery/{name})", "", f"{light}.{notes} Photograph: {credit}."]


if __name__ == "__main__":
    main(tyro.cli(Options))
