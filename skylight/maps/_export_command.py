"""``skylight export``: what other programs and browsers read of light and scenes."""

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from tyro.conf import Positional

from skylight._names import (
    PLAIN_READING,
    Convention,
    HarmonicConvention,
    LightTarget,
    MapReading,
)
from skylight.errors import InputError

if TYPE_CHECKING:
    from skylight.maps._export import ExportedLight

export = tyro.extras.SubcommandApp()


@export.command(name="decoder")
def export_decoder(
    out: Path = Path("sky_decoder.onnx"), model: Path | None = None, network: str | None = None
) -> None:
    """Write the sky decoder as an ONNX graph, checked against torch.

    Args:
        out: The .onnx file.
        model: Folder that `skylight train` wrote, of skies; by default the model that comes with
            skylight.
        network: Class of that model's network, where it is yours, as module:Class.
    """
    from skylight.models._bundle import Places, load_bundle, load_model, own_model
    from skylight.relight._export import export_decoder

    given = own_model(model, network)
    bundle = load_bundle() if given is None else load_model(given)
    if isinstance(bundle, Places):
        raise InputError(f"{model}: a model of places; give one of skies, or leave --model out")
    difference = export_decoder(bundle.light(), out)
    print(f"{out}: onnxruntime and torch differ by {difference:.1g} at most")


@export.command(name="codes")
def export_codes(
    out: Path = Path("sparse_codes.onnx"),
    dictionary: str = "ani",
    height: int = 32,
    rows: int | None = None,
) -> None:
    """Write what makes maps of sparse codes as an ONNX graph, checked against torch.

    Args:
        out: The .onnx file.
        dictionary: ani, box, iso, vmf, or the file of a learnt dictionary.
        height: Rows of the maps that were coded: maps of 64 and more have sharper filters too.
        rows: Rows of the maps that it makes; by default the same.
    """
    from skylight.csc._coder import SphericalSparseCoder
    from skylight.maps._export_codes import export_codes

    coder = SphericalSparseCoder(dictionary, height=height)
    difference = export_codes(coder, out, rows=rows)
    print(f"{out}: onnxruntime and torch differ by {difference:.1g} of the code's norm at most")


@export.command(name="scene")
def export_scene(
    mesh: Positional[Path],
    out: Path,
    height: int = 240,
    up: Literal["y", "z"] = "y",
    turn: float = 0.0,
    ground: bool = True,
) -> None:
    """Precompute how light reaches a mesh on a ground, for relighting it anywhere.

    Args:
        mesh: .obj, .ply, .glb, .gltf, .stl or .off; its materials are not used.
        out: The .npz file.
        height: Rows of the picture, which is 4:3.
        up: The mesh's own up axis.
        turn: Turn of the mesh to the right about that axis, degrees.
        ground: Whether there is a ground that takes the mesh's shadow.
    """
    from skylight.relight._export import Placement, precompute_scene
    from skylight.work._progress import stage_bar

    placement = Placement(up=up, turn_rad=math.radians(turn), ground=ground)
    with stage_bar() as progress:
        scene = precompute_scene(
            mesh,
            out,
            height=height,
            placement=placement,
            progress=lambda share: progress("tracing light", share),
        )
    print(f"{out}: {len(scene.pixels)} pixels lit from {len(scene.directions)} directions")


@export.command(name="blender")
def export_blender(
    estimate: Positional[Path],
    out: Positional[Path],
    photo: Path | None = None,
    lamps: int | None = None,
    from_convention: Convention = "skylight",
) -> None:
    """Write a portrait's light, camera, head and photograph for Blender's extension; or a map's.

    The extension "World from Portrait" runs this itself; docs/blender.md tells how to get it.
    Writes blender_scene.json, blender_light.hdr (the light without the sun or lamps, which
    blender_scene.json has), photograph.png (upright, as sRGB shows its light) and head.obj.

    Of a map, its sun or main lamp becomes a sun of Blender that stands where the map shows it, and
    leaves the map: load_light.py makes it, and the world of blender_light.hdr.

    Args:
        estimate: Folder that skylight estimate wrote for a photograph, or its estimate.json. Of
            several faces the first one's head and camera are taken. Or any .exr or .hdr lat-long
            map.
        out: Folder for the files.
        photo: The photograph, if it is not any more where it was.
        lamps: Of a map: so many of its strongest lights at most become suns; 1 by default.
        from_convention: Of a map: which program's way of turning lat-long maps it has; blender
            keeps it as Blender's own Environment Texture shows it.
    """
    from skylight.io._light import READ_SUFFIXES
    from skylight.maps._export import export_blender_scene, export_light

    if estimate.suffix.lower() in READ_SUFFIXES and not estimate.is_dir():
        if photo is not None:
            raise InputError(f"{estimate}: a map has no photograph: leave --photo out")
        exported = export_light(
            estimate,
            out,
            ["blender"],
            convention=from_convention,
            lamps=1 if lamps is None else lamps,
        )
        print(f"written into {out}: {', '.join(exported.files)}")
        _tell_lamps(exported, of_map=lamps != 0)
        return
    if lamps is not None or from_convention != "skylight":
        raise InputError(
            f"{estimate}: --lamps and --from-convention are of maps: leave them out for an estimate"
        )
    files = export_blender_scene(estimate, out, photo=photo)
    print(f"written into {out}: {', '.join(files)}")


@export.command(name="viewer")
def export_viewer(
    estimate: Positional[Path],
    out: Path,
    photo: Path | None = None,
    object_: Annotated[Path | None, tyro.conf.arg(name="object")] = None,
) -> None:
    """Write an estimate as one web page, which opens without server or network and can be mailed.

    It shows the photograph with an object in it to drag about, lit by the light that was found;
    the light as a panorama and on balls; and how far to trust it. The page has 3 MB at most. It
    holds the photograph, in 1280 pixels, its name and the fitted heads, but no EXIF data, paths,
    time or place.

    Args:
        estimate: Folder that skylight estimate wrote for a photograph.
        out: The .html file.
        photo: The photograph, in any size; by default where it was when it was estimated. Of
            several that share their light, one.
        object_: A .glb or .obj of your own that stands in the photograph first.
    """
    from skylight.maps._viewer import export_viewer

    written = export_viewer(estimate, out, photo=photo, model=object_)
    parts = {
        "photograph": written.photo,
        "light": written.light,
        "heads": written.heads,
        "object": written.model,
    }
    told = ", ".join(f"{name} {size / 1e6:.2f}" for name, size in parts.items() if size)
    print(f"{out}: {written.size / 1e6:.2f} MB ({told})")


def export_light(
    probe: Positional[Path],
    out: Positional[Path],
    as_: Annotated[tuple[LightTarget, ...], tyro.conf.arg(name="as")],
    from_convention: Convention = "skylight",
    sh_convention: HarmonicConvention = "skylight",
    lamps: int | None = None,
    face: int | None = None,
    reading: Annotated[MapReading, tyro.conf.OmitArgPrefixes] = PLAIN_READING,
) -> None:
    """Write a map of light the way other programs load it; docs/interchange.md tells how.

    threejs: lightprobe.json, a LightProbe for ObjectLoader. sh: sh27.json, nine spherical
    harmonics. ar: ar_light.json and six .hdr faces, ARCore's and ARKit's main light, ambient
    harmonics and cube map. gltf: light.glb with EXT_lights_image_based. usd: light.usda, a
    DomeLight. mitsuba: scene.xml. blender: load_light.py, which loads the .hdr beside it.

    Given an estimate's folder, the lamps that it lists (of --light sphere or lamps) become lights
    to move and switch, beside the rest of its map: DirectionalLight, KHR_lights_punctual,
    DistantLight, directional emitters, suns. sh and ar have all light in one. --lamps does so with
    the sun and the lamps of any map.

    Args:
        probe: .exr or .hdr lat-long map of the sphere, or of the sky; or the folder that skylight
            estimate wrote, or its estimate.json.
        out: Folder for the files.
        as_: One target or more.
        from_convention: Which program's way of turning lat-long maps the probe has.
        sh_convention: Of sh27.json: signs, order and what the numbers stand for.
        lamps: Of a map: find so many of its strongest compact lights at most (the sun, lamps,
            windows) and make them lights of their own, which leave the map.
        face: Pixels of a cube map's side, a power of two; by default as the map's detail asks.
        reading: How the map is read.
    """
    from skylight.maps._export import export_light

    exported = export_light(
        probe,
        out,
        as_,
        convention=from_convention,
        harmonics=sh_convention,
        lamps=lamps,
        face=face,
        reading=reading,
    )
    print(f"written into {out}: {', '.join(exported.files)}")
    _tell_lamps(exported, of_map=bool(lamps))
    if exported.cut > 0.001:
        print(
            f"skylight: take care: reflections of light.glb lack {100 * exported.cut:.1f} % of the "
            "light, cut off at 255 where its format ends; its diffuse light is whole",
            file=sys.stderr,
        )


def _tell_lamps(exported: "ExportedLight", *, of_map: bool) -> None:
    """What became lights of their own: how many, and where those stand that a map showed."""
    from skylight._figures import angles_deg
    from skylight.relight._lamps import disc_diameter_rad

    if exported.lamps:
        print(f"lamps that are lights of their own, not in the map: {len(exported.lamps)}")
    elif of_map:
        print("no compact light in the map: it is whole")
    for number, lamp in enumerate(exported.lamps if of_map else (), start=1):
        azimuth, zenith = angles_deg(lamp.direction)
        wide = math.degrees(disc_diameter_rad(lamp.spread_rad))
        told = ", ".join(f"{channel:.3g}" for channel in lamp.irradiance.tolist())
        print(
            f"lamp {number}: azimuth {azimuth:.1f}, zenith {zenith:.1f} degrees, "
            f"{wide:.2f} degrees wide, irradiance {told}"
        )
    if exported.cut_off:
        print(
            "skylight: take care: the map's brightest place has one level all over; where that is "
            "because it was cut off, its lamp is brighter than was found",
            file=sys.stderr,
        )
