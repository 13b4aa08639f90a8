"""The page ``measurements`` of the site, from the files in ``benchmarks/results``.

    python -m tools.build_measurements                              # docs/measurements.md
    python -m tools.build_measurements --overview RUN PICTURE.png

Takes every ``results.json`` of ``skylight evaluate`` (kept there as ``NAME.json``), every file of
a measuring tool and every JSON file of pytest-benchmark (``make bench``). No number of the page is
written by hand. ``docs/conf.py`` makes it whenever the site is built; it is in no commit.

The second form writes a picture of six skies, sunny to overcast, from the folder of a run of
``skylight evaluate sky-models``.
"""

import argparse
import json
from pathlib import Path

from skylight.errors import InputError
from skylight.evaluation._pictures import write_sheet
from skylight.evaluation._tables import markdown
from skylight.io._atomic import atomic_path
from tools import records
from tools.records import RESULTS, ROOT, Age

# sunny to overcast: categories of real maps, regimes of simulated ones
KINDS = ("outdoor-sun", "outdoor-lowsun", "outdoor-nosun", "clear", "broken", "overcast")
_MOST_NUMBERS = 24
HEAD = """\
# Measurements

Made by `tools/build_measurements.py` from `benchmarks/results` with this site. How each metric is
normalised is said in `skylight/imaging/_metrics.py`.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "measurements.md")
    parser.add_argument("--overview", type=Path, nargs=2, metavar=("RUN", "PICTURE.png"))
    options = parser.parse_args()
    if options.overview:
        overview(*options.overview)
        print(options.overview[1])
        return
    write(options.out, options.results)
    print(options.out)


def write(out: Path, results: Path = RESULTS) -> None:
    """The page, where it is not that already: Sphinx reads anew what is newer than its output."""
    text = page(results)
    if not out.is_file() or out.read_text(encoding="utf-8") != text:
        with atomic_path(out) as temporary:
            temporary.write_text(text, encoding="utf-8")


def overview(run: Path, picture: Path) -> None:
    """The first two skies of each kind, of real ones those that no setting was chosen by."""
    items = json.loads((run / "results.json").read_text())["items"]
    chosen = [name for kind in KINDS for name in _of_kind(items, kind)[:2]]
    if not chosen:
        raise InputError(f"{run}: no skies of the kinds {', '.join(KINDS)} in its results.json")
    write_sheet(picture, [run / "pictures" / f"{name}.png" for name in chosen], chosen)


def _of_kind(items: dict[str, dict], kind: str) -> list[str]:
    return [
        name
        for name, facts in items.items()
        if kind in (facts.get("category"), facts.get("regime"))
        and facts.get("half") != "development"
    ]


def page(results: Path) -> str:
    """All evaluations, then all benchmarks, in the order of their files' names."""
    every = records.every(results)
    contents = list(every.values())
    parts = [HEAD, _ages(every)]
    parts += ["#" + markdown(content) for content in contents if "rows" in content]
    parts += [_facts(content) for content in contents if "what" in content]
    parts += [_benchmarks(content) for content in contents if "benchmarks" in content]
    return "\n".join(parts)


def _ages(every: dict[str, records.Record]) -> str:
    """How old each record is, and which packages that it uses are different now."""
    lines = ["## How old they are", ""]
    if not records.has_history():
        lines.append("This site was built without the history, which tells what changed since.")
        return "\n".join(lines) + "\n"
    lines += [
        "A record is marked where a file that its command runs or imports, or a data file beside "
        "one, is different now from what it was at its commit; a file that was moved is too.",
        "",
        "| record | measured at | commits since | changed since |",
        "|---|---|---|---|",
        *(_age(name, records.commit_of(one), records.age(one)) for name, one in every.items()),
    ]
    return "\n".join(lines) + "\n"


def _age(name: str, commit: str, age: Age) -> str:
    packages = sorted({"/".join(path.split("/")[:2]) for path in age.changed})
    changed = ", ".join(f"`{package}`" for package in packages)
    since = ("", age.mark) if age.commits is None else (str(age.commits), changed or "nothing")
    return f"| {name} | {commit} | {' | '.join(since)} |"


def _facts(content: dict) -> str:
    """The plain numbers of a tool's own file; its lists are for those who read the file."""
    told = {"name", "what", "command", "commit", "date", "machine"}
    facts = [pair for k, v in content.items() if k not in told for pair in _numbers(k, v)]
    lines = [
        f"## {content['name']}",
        "",
        f"{content['what']}. `{content['command']}`, commit {content['commit']}, "
        f"{content['date']}, {content['machine']}.",
        "",
        "| | |",
        "|---|---|",
        *(f"| {name.replace('_', ' ')} | {value} |" for name, value in facts),
    ]
    return "\n".join(lines) + "\n"


def _numbers(name: str, value: object) -> list[tuple[str, str]]:
    """Numbers and words under their names; of tables those that are small enough to read."""
    if isinstance(value, dict):
        found = [pair for k, v in value.items() for pair in _numbers(f"{name} {k}", v)]
        return found if len(found) <= _MOST_NUMBERS else []
    if isinstance(value, float):
        return [(name, f"{value:.4g}")]
    return [(name, str(value))] if isinstance(value, int | str) else []


def _benchmarks(content: dict) -> str:
    """Least time of each benchmark (the one that other work disturbed least), and its extras."""
    machine = content["machine_info"]["cpu"].get("brand_raw", content["machine_info"]["machine"])
    lines = [
        "## Benchmarks",
        "",
        f"`make bench`, {content['datetime'][:10]}, {machine}. Least time of all rounds.",
        "",
        "| | seconds | |",
        "|---|---|---|",
    ]
    for one in sorted(content["benchmarks"], key=lambda b: b["fullname"]):
        extras = ", ".join(
            f"{name}: {value:.3g}" if isinstance(value, float) else f"{name}: {value}"
            for name, value in one["extra_info"].items()
        )
        lines.append(
            f"| {one['name'].removeprefix('test_')} | {one['stats']['min']:.3g} | {extras} |"
        )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
