"""The first minutes with skylight, as a newcomer's: docs/first_steps.md, with times and pictures.

    python -m tools.draw_first_steps

Clones this repository as it is committed, types there what the page shows, step by step, and takes
the times: skylight goes into an empty environment, Blender's module into another. Nothing else
should run on the machine.
"""

import os
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
WIDTH = 640
BALL = """
import bpy
import sys
from os.path import abspath

bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.extensions.package_install_files(
    filepath=abspath(sys.argv[1]), repo="user_default", enable_on_install=True
)
bpy.ops.world_from_portrait.set_up(folder=abspath("for_blender"))
head = [vertex.co for vertex in bpy.data.objects["portrait head"].data.vertices]
left, back, top = (min(v[0] for v in head), max(v[1] for v in head), max(v[2] for v in head))
bpy.ops.mesh.primitive_uv_sphere_add(
    segments=96, ring_count=48, radius=0.04, location=(left - 0.05, back - 0.12, top - 0.1)
)
bpy.ops.object.shade_smooth()
scene = bpy.context.scene
scene.cycles.samples, scene.render.filepath = 64, abspath("ball.png")
bpy.ops.render.render(write_still=True)
"""


@dataclass(frozen=True, kw_only=True)
class Step:
    """A heading, a program to save, what is typed, what to expect, and the picture of it."""

    title: str
    typed: str
    then: str
    program: tuple[str, str, str] = ("", "", "")  # its name, what it does, and its text
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
        then="torch is most of it. The last line saves the picture that these steps use, which "
        "comes with scikit-image (NASA's portrait of Eileen Collins, public domain); one of your "
        "own will do. All other steps are typed in the same folder.",
    ),
    Step(
        title="The light of a portrait",
        typed="skylight estimate portrait.png --light auto --out light",
        then="`light/report.png` shows what was found, and the verdict says how far to trust it.",
        picture="light/report.png",
    ),
    Step(
        title="The portrait in another light",
        typed="skylight relight-portrait light --key left --out left.png",
        then="A key light from the left; the estimate above is used again: "
        "[portraits](portraits.md).",
        picture="left.png",
    ),
    Step(
        title="A page for a friend",
        typed="skylight export viewer light --out page.html",
        then="One file that opens without a server: drag the object, turn the light.",
        picture="page.png",
    ),
    Step(
        title="The light in Blender",
        typed="skylight export blender light for_blender\n"
        "python3 ../../tools/build_blender_extension.py --out .",
        then="The second line packs Blender's extension, `world_from_portrait-*.zip`. Its *Set Up "
        "from Photo* does this step and the estimate from a panel: [Blender](blender.md).",
    ),
    Step(
        title="Blender without its window",
        typed=f"python3 -m venv blender-env\n. blender-env/bin/activate\npip install '{BPY}'",
        then="Blender's module needs Python 3.11. Blender itself needs no such environment: its "
        "*Install from Disk* takes the zip.",
    ),
    Step(
        title="A ball beside the head, by Blender",
        typed="export BLENDER_USER_RESOURCES=$PWD/blender\n. blender-env/bin/activate\n"
        "python ball.py world_from_portrait-*.zip",
        then="`ball.png`, here laid over the photograph.",
        program=(
            "ball.py",
            "installs the extension, sets the scene up, adds a diffuse ball and renders",
            BALL,
        ),
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
        with opened(place / "page.html", options.chromium) as shown:
            gathered(shown, 1)
            shown.screenshot(path=place / "page.png")
        lay_over(place / "ball.png", place / "portrait.png", place / "with_ball.png")
        IMAGES.mkdir(parents=True, exist_ok=True)
        for step in filter(lambda step: step.picture, STEPS):
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
    name, _, program = step.program
    if name:
        (place / name).write_text(program.lstrip())
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
    whole = sum(seconds.values()) / 60
    lines = [
        "# First steps",
        "",
        f"From a clone to a portrait in another light, a page to send and a scene in Blender: "
        f"{whole:.1f} minutes of waiting on {os.cpu_count()} cores without a graphics card. "
        "What is typed first is typed in a clone of skylight. `python -m tools.draw_first_steps` "
        "types what stands here, and wrote it down.",
    ]
    for number, step in enumerate(STEPS, start=1):
        lines += ["", f"## {number}. {step.title}", ""]
        name, does, program = step.program
        if name:
            lines += [f"Save this as `{name}`; it {does}:", "", f"```python{program}```", ""]
        lines += ["```sh", step.typed, "```", ""]
        lines += [f"{seconds[step.title]:.0f} s. {step.then}"]
        if step.picture:
            stem = Path(step.picture).stem
            lines += ["", f"![{step.title}](images/first_steps/{stem}.jpg)"]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main(tyro.cli(Options))
