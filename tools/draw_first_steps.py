"""The first minutes with skylight, as a newcomer's: docs/first_steps.md, with times and pictures.

    python -m tools.draw_first_steps

Clones this repository as it is committed, types there what the page shows, step by step, and takes
the times: skylight goes into an empty environment, Blender's module into another, where the program
of docs/blender.md is run. Nothing else should run on the machine.
"""

import os
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import tyro
from PIL import Image

from skylight.io._atomic import atomic_path
from tests.studio.browser.waiting import gathered
from tools.measured import write_measured
from tools.viewer_page import CHROMIUM, opened

PAGE = Path("docs/first_steps.md")
IMAGES = Path("docs/images/first_steps")
RESULT = Path("benchmarks/results/first-steps.json")
ROOT = Path(__file__).resolve().parents[1]
PLACE = "out/first_steps"  # in the clone; git ignores it
BPY = "bpy==4.2.*"
WIDTH = 960
BLENDER_PAGE = Path("docs/blender.md")
BALL = "ball.py"  # the program that it lists


@dataclass(frozen=True, kw_only=True)
class Step:
    """A heading, what is typed, what the page says of it, and the picture of it."""

    title: str
    typed: str
    then: str = ""
    picture: str = ""


PORTRAIT = (
    "from skimage import data; from PIL import Image; "
    "Image.fromarray(data.astronaut()).save('portrait.png')"
)
STEPS = (
    Step(
        title="Install",
        typed=f"mkdir -p {PLACE}\ncd {PLACE}\npython3 -m venv skylight-env\n"
        ". skylight-env/bin/activate\npip install --constraint ../../constraints.txt ../..\n"
        f'python -c "{PORTRAIT}"',
        then="Most of that is torch. The last line saves a sample portrait (NASA's picture of "
        "Eileen Collins, public domain); use one of your own if you like. "
        "[More on installing](install.md).",
    ),
    Step(
        title="The light of a portrait",
        typed="skylight estimate portrait.png --out light",
        then="Open `light/report.png`: the photograph, the fitted head, the light found, and a "
        "scene lit by it. The verdict says how far to trust it. `light/probe.exr` is the HDRI. "
        "[More on estimates](estimate.md).",
        picture="light/report.png",
    ),
    Step(
        title="The portrait in another light",
        typed="skylight relight-portrait light --key left --out left.png",
        then="A key light from the viewer's left, by the estimate above. "
        "[More on relighting](portraits.md).",
        picture="left.png",
    ),
    Step(
        title="A page for a friend",
        typed="skylight export viewer light --out page.html",
        then="One file that opens without a server: drag the object, turn the light. "
        "[Other programs](interchange.md), [Blender](blender.md).",
        picture="page.png",
    ),
)
IN_BLENDER = (  # of its own page; run here so that what it says is known to work
    Step(
        title="The light in Blender",
        typed="skylight export blender light for_blender\n"
        "python3 ../../tools/build_blender_extension.py --out .",
    ),
    Step(
        title="Blender without its window",
        typed=f"python3 -m venv blender-env\n. blender-env/bin/activate\npip install '{BPY}'",
    ),
    Step(
        title="A ball beside the head, by Blender",
        typed="export BLENDER_USER_RESOURCES=$PWD/blender\n. blender-env/bin/activate\n"
        f"python {BALL} world_from_portrait-*.zip",
        picture="with_ball.png",
    ),
)


@dataclass(frozen=True, kw_only=True)
class Options:
    """Walk through the first steps, and write the page about them."""

    chromium: str = CHROMIUM
    """Its program, to look at the page."""


def main(options: Options) -> None:
    begun = time.time()
    with tempfile.TemporaryDirectory(prefix="skylight-first-") as folder:
        clone = Path(folder) / "skylight"
        subprocess.run(["git", "clone", "--quiet", "--depth=1", ROOT.as_uri(), clone], check=True)
        place = clone / PLACE
        seconds = {step.title: taken(step, place if place.is_dir() else clone) for step in STEPS}
        (place / BALL).write_text(program_of(clone / BLENDER_PAGE))
        seconds |= {step.title: taken(step, place) for step in IN_BLENDER}
        with opened(place / "page.html", options.chromium) as shown:
            gathered(shown, 1)
            shown.screenshot(path=place / "page.png")
        lay_over(place / "ball.png", place / "portrait.png", place / "with_ball.png")
        IMAGES.mkdir(parents=True, exist_ok=True)
        for step in filter(lambda step: step.picture, (*STEPS, *IN_BLENDER)):
            small(place / step.picture, IMAGES / f"{Path(step.picture).stem}.jpg")
        sizes = {
            f"{name} mb": (place / name).stat().st_size / 1e6 for name in ("page.html", "left.png")
        }
    whole = sum(seconds.values())
    with atomic_path(PAGE) as temporary:
        temporary.write_text(page(seconds), encoding="utf-8")
    write_measured(
        RESULT,
        name=RESULT.stem,
        what="Seconds of a newcomer's first steps, from a fresh clone and an empty environment",
        command="python -m tools.draw_first_steps",
        begun=begun,
        facts={"cores": os.cpu_count(), "steps_s": seconds, "whole_s": whole, **sizes},
    )


def taken(step: Step, place: Path) -> float:
    """Seconds of its commands in a shell that knows the newcomer's environment, not this one."""
    print(step.typed, flush=True)
    paths = (place / "skylight-env" / "bin", Path(sys.base_prefix) / "bin", "/usr/bin", "/bin")
    kept = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    started = time.monotonic()
    subprocess.run(
        ["bash", "-ec", step.typed],
        cwd=place,
        check=True,
        env={**kept, "PATH": ":".join(map(str, paths))},
    )
    return time.monotonic() - started


def program_of(page: Path) -> str:
    """The one that begins by importing Blender."""
    (program,) = re.findall(r"```python\n(import bpy\n.*?)```", page.read_text("utf-8"), re.DOTALL)
    return program


def lay_over(above: Path, below: Path, out: Path) -> None:
    picture = Image.open(below).convert("RGBA")
    picture.alpha_composite(Image.open(above).convert("RGBA").resize(picture.size))
    picture.convert("RGB").save(out)


def small(source: Path, to: Path) -> None:
    picture = Image.open(source).convert("RGB")
    picture.thumbnail((WIDTH, WIDTH))
    with atomic_path(to) as temporary:
        picture.save(temporary, format="JPEG", quality=85)


def page(seconds: dict[str, float]) -> str:
    whole = sum(seconds[step.title] for step in STEPS) / 60
    lines = [
        "# Start",
        "",
        f"From a clone of skylight to a relit portrait: {whole:.1f} minutes of waiting on "
        f"{os.cpu_count()} cores without a graphics card. Rather click than type? After the first "
        "step: `pip install '../..[studio]'`, then [`skylight studio`](studio.md).",
    ]
    for number, step in enumerate(STEPS, start=1):
        lines += ["", f"## {number}. {step.title}", "", "```sh", step.typed, "```", ""]
        lines += [f"{seconds[step.title]:.0f} s. {step.then}"]
        if step.picture:
            stem = Path(step.picture).stem
            lines += ["", f"![{step.title}](images/first_steps/{stem}.jpg)"]
    lines += ["", "`python -m tools.draw_first_steps` runs these steps and writes this page."]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main(tyro.cli(Options))
