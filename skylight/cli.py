"""The ``skylight`` command: typed functions, imported when they are run."""

import inspect
import re
import sys
import traceback
import warnings
from pathlib import Path

import tyro
from tyro.conf import Positional, UseAppendAction

from skylight import __version__
from skylight._options import who_works
from skylight.errors import InputError, explain
from skylight.estimation._command import estimate
from skylight.io._atomic import PARTIAL
from skylight.live._command import live
from skylight.maps._command import code_probe, convert, decode_code, score
from skylight.maps._export_command import export, export_light
from skylight.object._command import estimate_object
from skylight.people._command import faces
from skylight.places._command import places
from skylight.portrait._command import relight_portrait
from skylight.probes._command import probe
from skylight.probes.cameras._command import camera
from skylight.relight._command import relight
from skylight.skies._command import skies
from skylight.studio._command import studio
from skylight.training._command import train
from skylight.work._device import Device

DESCRIPTION = """Recovers the light of a scene from a photo of a face, and lights things with it.

Results go to files and standard output, progress and errors to standard error. The exit code is
0 for success, 2 for a command or input that cannot be used, 1 for any other failure. Add --debug
to any command to see where in the program an error came from."""


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
    if arguments in ([], ["-h"], ["--help"]):
        print(_all_commands())
        return 0
    try:
        with warnings.catch_warnings():
            if not debug:
                warnings.simplefilter("ignore")  # what libraries tell programmers
            _app().cli(
                prog="skylight",
                description=DESCRIPTION,
                args=arguments,
                config=(
                    tyro.conf.FlagCreatePairsOff,
                    tyro.conf.PositionalMetavarFromFieldName,
                    tyro.conf.DisallowNone,
                ),
            )
    except BrokenPipeError:  # of standard output, which is told where the program ends
        raise
    except (Exception, KeyboardInterrupt) as error:
        if debug:
            traceback.print_exc()
        message, code = explain(error)
        # not the folder that becomes the results
        message = re.sub(rf"{re.escape(PARTIAL)}\w+/", "", message)
        print(f"skylight: {' '.join(message.split())}", file=sys.stderr)
        return code
    return 0


def demo(out: Path = Path("skylight_demo")) -> None:
    """Show what skylight does, without any data: three estimates.

    Takes one to two minutes on two cores.

    The first is of a rendered face in a simulated light that is known, so the estimate is scored;
    the second of a photograph of an astronaut that comes with scikit-image, in a studio's flat
    light; the third fails, and says so: a man in profile, whose ear is taken for a face.

    Args:
        out: Folder for the results.
    """
    from skylight.estimation._demo import demonstrate
    from skylight.estimation._examples import EXAMPLES
    from skylight.work._progress import stage_bar

    with stage_bar() as progress:
        shown = demonstrate(out, progress)
    print(f"{shown.synthetic / 'comparison.png'}: a rendered face, its true light and the estimate")
    for name, value in shown.scores.items():
        print(f"    {name:<14} {value:8.3f}")
    print(f"{shown.synthetic / 'report.png'}: that estimate step by step")
    for folder, example in zip(shown.photographs, EXAMPLES, strict=True):
        print(f"{folder / 'report.png'}: {example.expected}")


def evaluate(
    name: Positional[str],
    out: Path,
    quick: bool = False,
    data: Path | None = None,
    model: Path | None = None,
    network: str | None = None,
    device: Device = "auto",
    workers: int = 2,
    cluster: str | None = None,
    peer: UseAppendAction[tuple[str, ...]] = (),
) -> None:
    """Compute one of the tables or figures of the evaluation.

    Args:
        name: Which one; a name that does not exist is answered with the list. Or all: each that
            there are data for, and one page of their results.
        out: Folder for the results.
        quick: A small run that shows the form of the result in minutes.
        data: Folder of collected data, where the evaluation needs any; of all, one with folders
            hdr, meshes, faces, lamps, scenes, indoor and relit, as far as they are there.
        model: Of faces and skies: folder of a trained model of your own instead of the one that
            comes with skylight.
        network: Class of that model's network, where it is yours, as module:Class.
        device: Of faces: where their light is optimised.
        workers: Processes that work at the same time; 0 for one per core.
        cluster: A dask scheduler's address, whose workers do it instead.
        peer: Of relit-lamps: NAME=FOLDER, once for each: others' relit pictures, named by pair,
            that get a row of that name.
    """
    who = who_works(workers, cluster, out)
    peers = _folders_by_name(peer)
    from skylight.evaluation._known_faces import EstimateOptions
    from skylight.evaluation._main import evaluate, evaluate_all
    from skylight.models._bundle import own_model

    chosen = own_model(model, network)
    is_default = chosen is None and device == "auto"
    options = None if is_default else EstimateOptions(model=chosen, device=device)
    if name == "all":
        if peers:
            raise InputError("--peer is of one evaluation: give its name in place of all")
        evaluate_all(quick=quick, data=data, out=out, workers=who, options=options)
    else:
        evaluate(name, quick=quick, data=data, out=out, workers=who, options=options, peers=peers)


def _folders_by_name(given: tuple[str, ...]) -> dict[str, Path]:
    """Of NAME=FOLDER."""
    folders: dict[str, Path] = {}
    for text in given:
        name, _, folder = text.partition("=")
        if not name or not folder or name in folders:
            raise InputError(f"--peer {text}: give NAME=FOLDER, each name once")
        folders[name] = Path(folder)
    return folders


export.command(name="light")(export_light)
# In the order in which they are listed; the first are for every day.
EVERYDAY = {
    "estimate": estimate,
    "relight-portrait": relight_portrait,
    "studio": studio,
    "live": live,
    "demo": demo,
    "export": (export, "Write what other programs and browsers need."),
}
RESEARCH = {
    "estimate-object": estimate_object,
    "relight": relight,
    "convert": convert,
    "score": score,
    "code": code_probe,
    "decode": decode_code,
    "probe": (probe, "Make light probes, and use them."),
    "camera": (camera, "Measure a camera: a board to print, lens and response."),
    "skies": (skies, "Simulate skies, or index a folder of captured ones."),
    "places": (places, "Simulate places whose light is known: outdoors, rooms, studios, streets."),
    "train": train,
    "faces": (faces, "Faces whose light is known: render or calibrate."),
    "evaluate": evaluate,
}


def _app() -> tyro.extras.SubcommandApp:
    app = tyro.extras.SubcommandApp()
    for name, command in (EVERYDAY | RESEARCH).items():
        if isinstance(command, tuple):
            app.command(command[0], name=name, help=command[1])
        else:
            app.command(name=name)(command)
    return app


def _all_commands() -> str:
    """The page of ``skylight --help``: a line for each command, to its first colon or semicolon."""
    lines = ["usage: skylight [-h] [--version] COMMAND ...", "", DESCRIPTION]
    for heading, commands in (("Every day", EVERYDAY), ("Research", RESEARCH)):
        lines += ["", f"{heading}:"]
        for name, command in commands.items():
            text = command[1] if isinstance(command, tuple) else inspect.getdoc(command) or ""
            does = re.split(r"[:;.\n]", text)[0]
            lines.append(f"  {name:<18}{does}")
    lines += ["", "`skylight COMMAND --help` tells of each, and lists its options."]
    return "\n".join(lines)
