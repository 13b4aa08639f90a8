"""The ``skylight`` command: every verb is a typed function elsewhere, imported when it is run."""

import math
import os
import re
import sys
import traceback
import warnings
from pathlib import Path
from typing import Annotated, Literal

import tyro
from tyro.conf import Positional

from skylight import __version__
from skylight.cli.camera import camera
from skylight.cli.convert import convert
from skylight.cli.faces import faces
from skylight.cli.probe import probe
from skylight.errors import InputError, SkylightError

# Parsing must not import torch, so the choices stand here again; a test compares the two.
Light = Literal["autoencoder", "sunsky", "sh9", "sh25"]
ObjectLight = Literal["ani", "iso", "vmf", "sh9", "sh25", "sh49"]
Landmarks = Literal["dlib", "mediapipe"]
CodeWeights = Literal["l1", "nonnegative", "free"]
MapLayout = Literal["auto", "skylatlong", "latlong", "angular", "fisheye"]
Decoding = tyro.conf.create_mutex_group(required=False)
DESCRIPTION = """Recovers the light of a scene from a photo of a face, and lights things with it.

Results go to files and standard output, progress and errors to standard error. The exit code is
0 for success, 2 for a command or input that cannot be used, 1 for any other failure. Add --debug
to any command to see where in the program an error came from."""

app = tyro.extras.SubcommandApp()
skies = tyro.extras.SubcommandApp()
export = tyro.extras.SubcommandApp()


def main(arguments: list[str] | None = None) -> int:
    """Run one command and return its exit code.

    Whatever goes wrong ends as one line on standard error; ``--debug``, anywhere, adds the
    traceback. The parser itself leaves by :class:`SystemExit`: 0 after help, 2 after an error.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    debug = "--debug" in arguments
    arguments = [argument for argument in arguments if argument != "--debug"]
    if arguments == ["--version"]:
        print(f"skylight {__version__}")
        return 0
    try:
        with warnings.catch_warnings():
            if not debug:
                warnings.simplefilter("ignore")  # what libraries tell programmers
            app.cli(
                prog="skylight",
                description=DESCRIPTION,
                args=arguments or ["--help"],
                config=(
                    tyro.conf.FlagCreatePairsOff,
                    tyro.conf.PositionalMetavarFromFieldName,
                    tyro.conf.DisallowNone,
                ),
            )
    except (Exception, KeyboardInterrupt) as error:
        if debug:
            traceback.print_exc()
        message, code = explain(error)
        message = re.sub(r"\.partial-\w+/", "", message)  # the folder that becomes the results
        print(f"skylight: {' '.join(message.split())}", file=sys.stderr)
        return code
    return 0


def explain(error: BaseException) -> tuple[str, int]:
    """(what to tell the user, exit code)."""
    if isinstance(error, SkylightError):
        return str(error), error.exit_code
    if isinstance(error, KeyboardInterrupt):
        return "interrupted; the results of earlier runs are untouched", 1
    # torch's allocators raise plain RuntimeErrors
    no_room = isinstance(error, RuntimeError) and (
        "allocate memory" in str(error) or "out of memory" in str(error)
    )
    if isinstance(error, MemoryError) or no_room:
        return "out of memory; close other programs, or use a smaller picture", 1
    if isinstance(error, OSError) and error.strerror:
        file = f"{error.filename}: " if error.filename else ""
        return f"{file}{error.strerror}; check the disk's free space and your access to it", 1
    first = str(error).partition("\n")[0]
    return f"internal error ({type(error).__name__}: {first}); rerun with --debug", 1


@app.command
def estimate(
    photo: Positional[Path],
    more: Positional[tuple[Path, ...]] = (),
    shared_light: bool = False,
    light: Light = "autoencoder",
    face: int | None = None,
    faces: Literal["one", "all"] = "one",
    device: Literal["cpu", "cuda"] = "cpu",
    out: Path | None = None,
    gamma: Annotated[float | None, Decoding] = None,
    linear: Annotated[bool, Decoding] = False,
    landmarks: Landmarks = "dlib",
    landmark_model: Path | None = None,
) -> None:
    """Recover the light in which a face was photographed, or several.

    Faces under one light tell more of it together: all of a picture with --faces all, those of
    several pictures with --shared-light. Every face has its own albedo, every picture its own
    exposure. Cameras are taken to be level and, of several pictures, to look the same way: a
    burst, a person who turns, a group that is photographed again.

    Writes probe.exr and probe.hdr (linear lat-long maps of 64 x 128 pixels in the camera's frame:
    the centre is where the camera looks, its right is the picture's right), posterior.exr (how
    likely the sun stands where, per sr), mesh.obj (the fitted head; mesh_1.obj and so on where
    there are several), estimate.json (all numbers) and report.png (a picture of it all).

    Args:
        photo: Colour picture of a face: JPEG, PNG, TIFF, EXR or Radiance HDR.
        more: Further pictures in the same light; only with --shared-light.
        shared_light: All pictures were taken in one light by cameras that looked the same way.
        light: Light model: learnt skies, Preetham's sky with a sun, or spherical harmonics with
            9 or 25 coefficients.
        face: Which face of each picture, counted from 1, the largest; 1 unless said otherwise.
        faces: One face of each picture, or all.
        device: Where the optimisation runs.
        out: Folder for the results; by default PHOTO's name with _light, in the current folder.
        gamma: The picture's values are light to the power of 1/GAMMA, instead of sRGB.
        linear: The picture's values are proportional to light, instead of sRGB.
        landmarks: What finds the face: dlib, or MediaPipe's landmarker, free for commercial use.
        landmark_model: MediaPipe's face_landmarker.task, which you download yourself.
    """
    from skylight.app.estimate import check_device, choose_landmarker, estimate_with_steps
    from skylight.app.progress import stage_bar
    from skylight.app.results import MESHES, mesh_names, results_folder, write_results
    from skylight.app.summary import summary
    from skylight.imaging.photo import read_photo

    if more and not shared_light:
        raise InputError(
            f"{1 + len(more)} pictures: add --shared-light if they were taken in the same light by "
            "cameras that looked the same way, else estimate them one by one"
        )
    if face is not None and faces == "all":
        raise InputError(f"--face {face} and --faces all contradict each other: leave one out")
    out = out or Path(f"{photo.stem}_light")
    paths = (photo, *more)
    pictures = [read_photo(path, decode="linear" if linear else gamma) for path in paths]
    check_device(device)
    landmarker = choose_landmarker(landmarks, landmark_model)
    with stage_bar() as progress, results_folder(out, MESHES) as folder:
        result = estimate_with_steps(
            pictures,
            [str(path) for path in paths],
            light=light,
            face="all" if faces == "all" else 1 if face is None else face,
            device=device,
            landmarker=landmarker,
            progress=progress,
        )
        progress("writing the results", 0.0)
        write_results(folder, pictures, [str(path) for path in paths], result)
    for advice in result.estimate.advice:
        print(f"skylight: take care: {advice}", file=sys.stderr)
    print(summary(result))
    meshes = ", ".join(mesh_names(result))
    files = f"probe.exr, probe.hdr, posterior.exr, {meshes}, estimate.json, report.png"
    print(f"written into {out}: {files}")


@app.command(name="estimate-object")
def estimate_object(
    mesh: Positional[Path],
    photo: Positional[Path],
    camera: Path,
    light: ObjectLight = "ani",
    activations: int = 50,
    mask: Path | None = None,
    albedo: str | None = None,
    roughness: float | None = None,
    reflectance: float | None = None,
    out: Path | None = None,
    gamma: Annotated[float | None, Decoding] = None,
    linear: Annotated[bool, Decoding] = False,
) -> None:
    """Recover the light in which an object of known shape was photographed.

    Writes probe.exr and probe.hdr (linear lat-long maps of 64 x 128 pixels in the mesh's world:
    the centre looks along -Z, +X is to its right, +Y up), estimate.json (all numbers) and
    comparison.png (the object as seen and as re-rendered, and the light).

    Args:
        mesh: .obj, .ply, .glb, .gltf, .stl or .off; its materials are not used.
        photo: Colour picture of the object: JPEG, PNG, TIFF, EXR or Radiance HDR.
        camera: JSON with fov_deg (vertical) or focal_px, and either position, look_at and up (in
            the mesh's world) or world_from_camera (4 x 4; the camera looks along -Z, +Y is up).
        light: Sparse code of anisotropic Gaussians (ani), isotropic ones (iso) or equal lobes
            (vmf), or 9, 25 or 49 spherical harmonics.
        activations: Most activations of a sparse code.
        mask: Picture of the photo's size, white where the object shows and black elsewhere.
        albedo: Reflectance of the object as R,G,B; by default it is taken to be grey and counts
            as brightness of the light.
        roughness: Roughness of a glossy object, 0.25 to 1; without it, the object is matt. How
            strong the gloss is against the matt part depends on --albedo.
        reflectance: Of a glossy object, seen head-on; by default 0.04.
        out: Folder for the results; by default PHOTO's name with _light, in the current folder.
        gamma: The picture's values are light to the power of 1/GAMMA, instead of sRGB.
        linear: The picture's values are proportional to light, instead of sRGB.
    """
    from skylight.app.known_object import (
        estimate_known_object,
        material_of,
        summarise_object,
        write_object_results,
    )
    from skylight.app.progress import stage_bar
    from skylight.app.results import results_folder
    from skylight.imaging.photo import read_photo

    out = out or Path(f"{photo.stem}_light")
    material = material_of(albedo, roughness, reflectance)
    picture = read_photo(photo, decode="linear" if linear else gamma)
    with stage_bar() as progress, results_folder(out) as folder:
        result = estimate_known_object(
            mesh,
            picture,
            camera,
            light=light,
            activations=activations,
            mask=mask,
            material=material,
            progress=progress,
        )
        progress("writing the results", 0.0)
        write_object_results(folder, result, mesh=mesh, photo=photo)
    for advice in result.light.advice:
        print(f"skylight: take care: {advice}", file=sys.stderr)
    print(summarise_object(result))
    print(f"written into {out}: probe.exr, probe.hdr, estimate.json, comparison.png")


@app.command(name="code")
def code_probe(
    probe: Positional[Path],
    out: Path,
    dictionary: str = "ani",
    activations: int = 64,
    weights: CodeWeights = "l1",
    height: Literal[32, 64, 128] | None = None,
) -> None:
    """Write a map of light as a sparse code: a handful of lobes and where they stand.

    Beside the code, OUT with the ending .png shows the map, the decoded map and the lobes.

    Args:
        probe: .exr or .hdr lat-long map of the whole sphere (width 2 heights).
        out: The .json file.
        dictionary: Anisotropic Gaussians (ani), isotropic ones (iso), equal lobes (vmf), or the
            file of a learnt dictionary.
        activations: Most lobes to use; a simple map gets fewer.
        weights: Of either sign with a weak L1 norm, none below 0, or plain least squares.
        height: Rows to average the map down to; by default its own, 128 at most.
    """
    from skylight.app.progress import stage_bar
    from skylight.app.results import results_folder
    from skylight.app.sparse_codes import check_code_name, code_map, summarise_code, write_code

    check_code_name(out)
    with stage_bar() as progress, results_folder(out.parent) as folder:
        coded = code_map(
            probe,
            dictionary=dictionary,
            activations=activations,
            weights=weights,
            height=height,
            progress=progress,
        )
        progress("writing the results", 0.0)
        write_code(folder, out.name, coded, title=probe.name)
    print(summarise_code(coded))
    print(f"written: {out} and {out.with_suffix('.png').name}")


@app.command(name="decode")
def decode_code(
    code: Positional[Path],
    out: Path,
    height: int | None = None,
    dictionary: Path | None = None,
) -> None:
    """Write the map of a sparse code; what is below zero there is cut off.

    Args:
        code: .json file that `skylight code` wrote.
        out: The map to write: .exr or .hdr.
        height: Rows of the map; by default those of the map that was coded.
        dictionary: File of the learnt dictionary with which the code was made.
    """
    from skylight.app.sparse_codes import decode_file

    share = decode_file(code, out, height=height, dictionary=dictionary)
    print(f"{out}: {100 * share:.2g} % of the energy cut off below zero")


@app.command
def demo(out: Path = Path("skylight_demo")) -> None:
    """Show what skylight does, without any data: two estimates.

    Takes one to two minutes on two cores.

    The first is of a rendered face in a simulated light that is known, so the estimate is scored;
    the second of a photograph of an astronaut that comes with scikit-image.

    Args:
        out: Folder for the results.
    """
    from skylight.app.demo import demonstrate
    from skylight.app.progress import stage_bar

    with stage_bar() as progress:
        shown = demonstrate(out, progress)
    print(f"{shown.synthetic / 'comparison.png'}: a rendered face, its true light and the estimate")
    for name, value in shown.scores.items():
        print(f"    {name:<14} {value:8.3f}")
    print(f"{shown.synthetic / 'report.png'}: that estimate step by step")
    print(f"{shown.photograph / 'report.png'}: the light of a real photograph")


@skies.command(name="simulate")
def simulate_skies(
    days: int,
    out: Path,
    size: str = "32x128",
    interval: float = 80.0,
    first_seed: int = 0,
    workers: int = 0,
    clear: float | None = None,
    broken: float | None = None,
    overcast: float | None = None,
) -> None:
    """Simulate days of skies as EXR maps with an index; an interrupted run goes on.

    Args:
        days: How many days.
        out: Folder for the maps and index.csv.
        size: Height x width of a map of the upper hemisphere: its width is 4 heights.
        interval: Minutes from one sky to the next; only skies with the sun up are kept.
        first_seed: Seed of the first day; the others follow.
        workers: Processes that work at the same time; 0 for one per core.
        clear: Share of clear days. Where any of the three shares is given, those that are not
            are 0, and they are scaled to a sum of 1; by default 0.35, 0.4 and 0.25.
        broken: Share of days with broken clouds.
        overcast: Share of overcast days.
    """
    height = _sky_height(size)
    for name, value in (("days", days), ("interval", interval)):
        if not value > 0 or not math.isfinite(value):
            raise InputError(f"--{name} must be above 0, got {value}")
    if workers < 0:
        raise InputError(f"--workers must be 0 or more, got {workers}")
    from skylight.app.progress import stage_bar
    from skylight.app.sky_folders import counts, regime_shares, with_time_left
    from skylight.skies.index import read_index
    from skylight.skies.simulated import simulate_folder

    shares = regime_shares(clear=clear, broken=broken, overcast=overcast)
    with stage_bar() as progress:
        index = simulate_folder(
            out,
            days=days,
            first_seed=first_seed,
            interval_min=interval,
            height=height,
            shares=shares,
            workers=workers or os.cpu_count() or 1,
            progress=with_time_left("day", progress),
        )
    print(f"{index}: {counts(read_index(out))}")


@skies.command(name="index")
def index_skies(
    folder: Positional[Path],
    out: Path | None = None,
    days: Path | None = None,
    layout: MapLayout = "auto",
    field_deg: float = 180.0,
    tolerance: float | None = None,
) -> None:
    """Write an index for a folder of captured skies, and say what was found and refused.

    Maps are .exr or .hdr, in FOLDER or folders within it. Refused are those with a clipped sun,
    with values that are not finite or negative, all black, or too small. Days are kept apart in
    training, validation and test.

    Args:
        folder: Folder of maps.
        out: The index to write; by default index.csv in FOLDER.
        days: CSV with the columns file,day or file,day,time. A map that is not in it has the day
            of its name (20240131_154500 and the like), else that of its header's capture date,
            else a day of its own.
        layout: Of the maps: upper half (skylatlong, width 4 heights) or whole lat-long maps
            (width 2 heights), or squares with the zenith in the middle and equal angles from it
            at equal distances: angular has azimuth 0 at the bottom and +90 degrees on the
            right, fisheye azimuth 0 at the top and +90 on the left. auto goes by the shape and
            takes squares for angular.
        field_deg: Degrees that a square map shows across its inscribed circle.
        tolerance: How far the sets' shares of skies, and of sunny ones, may be from those
            wanted; by default 0.05, or 10 / days where that is more.
    """
    from skylight.app.progress import stage_bar
    from skylight.app.sky_folders import counts, describe, with_time_left
    from skylight.skies.captures import index_folder

    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder; give one with .exr or .hdr maps")
    with stage_bar() as progress:
        index, records, refusals = index_folder(
            folder,
            out=out,
            layout=None if layout == "auto" else layout,
            field_deg=field_deg,
            days=days,
            tolerance=tolerance,
            progress=with_time_left("map", progress),
        )
    for line in describe(records, refusals):
        print(line)
    print(f"{index}: {counts(records)}, {len(refusals)} refused")


@export.command(name="decoder")
def export_decoder(out: Path = Path("sky_decoder.onnx")) -> None:
    """Write the sky decoder as an ONNX graph, checked against torch.

    Args:
        out: The .onnx file.
    """
    from skylight.models.shipped import autoencoder_light
    from skylight.relight.export import export_decoder

    difference = export_decoder(autoencoder_light(), out)
    print(f"{out}: onnxruntime and torch differ by {difference:.1g} at most")


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
    from skylight.app.progress import stage_bar
    from skylight.relight.export import Placement, precompute_scene

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


@app.command
def relight(
    scene: Positional[Path],
    out: Path,
    probe: Path | None = None,
    latent: Path | None = None,
    azimuth: float | None = None,
    decoder: Path | None = None,
    exposure: float | None = None,
    ground_albedo: float | None = None,
) -> None:
    """Light a precomputed scene, by a probe or by the sky of a latent; needs no torch.

    Args:
        scene: .npz file that `skylight export scene` wrote.
        out: Picture to write: .png (8-bit sRGB) or .exr (linear).
        probe: Light as an .exr or .hdr lat-long map, such as an estimate's probe.exr.
        latent: Light as JSON: 64 latents, or an estimate's estimate.json.
        azimuth: Where the latent's sun goes, or how far a probe is turned: degrees to the right.
        decoder: .onnx file that `skylight export decoder` wrote; by default the one shipped.
        exposure: Factor on radiance, with 1 as white.
        ground_albedo: Reflectance of the ground, from 0 to 1.
    """
    from skylight.relight.runtime import relight_files

    relight_files(
        scene,
        out,
        probe=probe,
        latent=latent,
        azimuth_deg=azimuth,
        decoder=decoder,
        exposure=exposure,
        ground_albedo=ground_albedo,
    )
    print(out)


@app.command
def evaluate(
    name: Positional[str],
    out: Path,
    quick: bool = False,
    data: Path | None = None,
) -> None:
    """Compute one of the tables or figures of the evaluation.

    Args:
        name: Which one; a name that does not exist is answered with the list.
        out: Folder for the results.
        quick: A small run that shows the form of the result in minutes.
        data: Folder of collected data, where the evaluation needs any.
    """
    from skylight.evaluation.main import evaluate

    evaluate(name, quick=quick, data=data, out=out)


app.command(convert)
app.command(skies, name="skies", help="Simulate skies, or index a folder of captured ones.")
app.command(export, name="export", help="Write what relighting without torch needs.")
app.command(probe, name="probe", help="Make light probes, and use them.")
app.command(faces, name="faces", help="Faces whose light is known: render or calibrate.")
app.command(camera, name="camera", help="Measure a camera: a board to print, lens and response.")


def _sky_height(size: str) -> int:
    """The height that "HxW" names."""
    height, _, width = size.partition("x")
    if not (height.isdigit() and width.isdigit() and int(width) == 4 * int(height) > 0):
        raise InputError(f"--size must be HEIGHTxWIDTH with a width of 4 heights, got {size!r}")
    return int(height)
