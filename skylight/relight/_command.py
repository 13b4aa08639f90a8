"""``skylight relight``, and the whole ``skylight`` command where only relighting is installed."""

import inspect
import re
import sys
import traceback
from argparse import ArgumentParser
from pathlib import Path
from typing import get_args

from skylight import __version__
from skylight.errors import explain


def relight(
    scene: Path,
    /,
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
    from skylight.relight._runtime import relight_files

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


def main(arguments: list[str] | None = None) -> int:
    """Run ``relight``, the one command without the full package, and return its exit code.

    ``--debug``, anywhere, adds the traceback to an error, as in the full command.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    debug = "--debug" in arguments
    arguments = [argument for argument in arguments if argument != "--debug"]
    if arguments and arguments[0] != "relight" and not arguments[0].startswith("-"):
        print(
            f"skylight: only relighting is installed here; `{arguments[0]}` needs the full "
            "package: `pip install .` in a clone of skylight",
            file=sys.stderr,
        )
        return 2
    options = vars(_parser().parse_args(arguments or ["--help"]))
    scene = options.pop("scene")
    try:
        relight(scene, **options)
    except BrokenPipeError:  # of standard output, which is told where the program ends
        raise
    except (Exception, KeyboardInterrupt) as error:
        if debug:
            traceback.print_exc()
        message, code = explain(error)
        print(f"skylight: {message}", file=sys.stderr)
        return code
    return 0


def _parser() -> ArgumentParser:
    """The arguments of :func:`relight`, read off its signature and docstring as tyro reads them."""
    what, _, arguments = (inspect.getdoc(relight) or "").partition("\n\nArgs:\n")
    help_of = dict(re.findall(r"^ +(\w+): (.+)$", arguments, re.MULTILINE))
    parser = ArgumentParser(
        "skylight",
        description="Relighting alone; the other commands come with the full package. Add --debug "
        "to see where in the program an error came from.",
    )
    parser.add_argument("--version", action="version", version=f"skylight {__version__}")
    commands = parser.add_subparsers(required=True)
    command = commands.add_parser("relight", help=what, description=what)
    for name, parameter in inspect.signature(relight).parameters.items():
        kind = (get_args(parameter.annotation) or (parameter.annotation,))[0]
        if parameter.kind is parameter.POSITIONAL_ONLY:
            command.add_argument(name, type=kind, help=help_of[name])
        else:
            command.add_argument(
                f"--{name.replace('_', '-')}",
                type=kind,
                required=parameter.default is parameter.empty,
                help=help_of[name],
            )
    return parser
