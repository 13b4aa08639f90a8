"""The documentation says what is there: links, names, versions, licences, examples."""

import ast
import json
import re
import subprocess
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from skimage.data import astronaut

from skylight.cli import EVERYDAY, RESEARCH, main
from skylight.faces._landmarkers import choose_landmarker
from skylight.io._files import write_png

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
MADE = ["docs/measurements.md"]  # by the site's builder
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
# Declared names of licences, as people write them, to SPDX's
SPDX = {
    "apache 2.0": "Apache-2.0",
    "apache software license": "Apache-2.0",
    "boost software license": "BSL-1.0",
    "mit": "MIT",
    "mit license": "MIT",
    "the mit license": "MIT",
    "python software foundation license": "PSF-2.0",
    "mozilla public license 2.0 (mpl 2.0)": "MPL-2.0",
    "3-clause bsd": "BSD-3-Clause",
    "bsd 2-clause license": "BSD-2-Clause",
}


def pages() -> list[str]:
    found = [
        *ROOT.glob("*.md"),
        *DOCS.glob("*.md"),
        *DOCS.glob("api/*.md"),
        *DOCS.glob("concepts/*.md"),
    ]
    return [str(path.relative_to(ROOT)) for path in sorted(found)]


@pytest.mark.parametrize("page", pages())
def test_links_lead_somewhere(page):
    path = ROOT / page
    links = re.findall(r"\]\((?!https?:|#|_walkthroughs/|_drawings/)([^)#]+)", path.read_text())
    there = {ROOT / made for made in MADE}
    missing = [link for link in links if not (path.parent / link).exists()]
    assert [link for link in missing if (path.parent / link).resolve() not in there] == []


@pytest.mark.parametrize("page", pages())
def test_pages_that_are_built_have_their_source(page):
    text = (ROOT / page).read_text()
    for name in re.findall(r"_walkthroughs/(\w+)", text):
        assert name == "index" or (DOCS / "walkthroughs" / f"{name}.py").is_file()
    drawn = re.findall(r'"(\w+)": draw_', (DOCS / "drawings.py").read_text())
    assert set(re.findall(r"_drawings/(\w+)\.svg", text)) <= set(drawn)


def test_readme_is_one_screen_with_a_picture():
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= 45
    assert "](docs/images/" in text


@pytest.mark.parametrize("page", [page for page in pages() if page.startswith("docs/")])
def test_every_page_is_in_the_table_of_contents(page):
    name = page.removeprefix("docs/").removesuffix(".md")
    listed = re.findall(r"^[\w/]+$", (DOCS / "index.md").read_text(), re.MULTILINE)
    assert name == "index" or name in listed


def test_the_reference_has_every_package_with_public_names():
    package = ROOT / "skylight"
    here = {
        ".".join(path.parent.relative_to(package).parts) for path in package.rglob("*/__init__.pyi")
    }
    listed = re.findall(r"^   skylight\.([\w.]+)$", (DOCS / "api/index.md").read_text(), re.M)
    assert set(listed) == here | {"errors"}
    assert len(listed) == len(here) + 1


def test_the_architecture_has_every_package_in_the_words_of_its_docstring():
    package = ROOT / "skylight"
    files = [package / "errors.py", *package.rglob("*/__init__.py")]
    said = {}
    for path in set(files) - {package / "__init__.py"}:
        place = path.parent if path.name == "__init__.py" else path.with_suffix("")
        first = (ast.get_docstring(ast.parse(path.read_text())) or "").split("\n")[0]
        said[".".join(place.relative_to(package).parts)] = first.replace("``", "`")
    text = (DOCS / "architecture.md").read_text()
    table = text[text.index("| package |") : text.index("## Sparse codes")]
    assert dict(re.findall(r"^\| `([\w.]+)` \| (.+) \|$", table, re.M)) == said


def test_the_layers_are_those_of_the_linter():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    text = (DOCS / "architecture.md").read_text()
    assert "\n".join(contracts["contracts"][0]["layers"]) in text


def test_the_reference_has_every_public_name():
    import skylight

    text = (DOCS / "api/index.md").read_text()
    assert [
        n for n in skylight.__all__ if n != "__version__" and f"`skylight.{n}`" not in text
    ] == []


def test_the_page_of_commands_has_each():
    text = (DOCS / "commands.md").read_text()
    assert [name for name in EVERYDAY | RESEARCH if f"`skylight {name}" not in text] == []


@pytest.mark.parametrize("arguments", [[], ["-h"], ["--help"]])
def test_help_lists_each_command_in_a_line_the_everyday_ones_first(arguments, capsys):
    assert main(arguments) == 0
    listed = re.findall(r"^  ([\w-]+) +\w.*$", capsys.readouterr().out, re.M)
    assert listed == [*EVERYDAY, *RESEARCH]
    assert len(EVERYDAY) == 6


def test_versions_agree():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["cff-version"] == "1.2.0"
    assert str(citation["version"]) == PROJECT["version"]
    assert citation["license"] == PROJECT["license"]
    assert f"## {PROJECT['version']} - " in (ROOT / "CHANGELOG.md").read_text()
    assert metadata(PROJECT["name"])["Version"] == PROJECT["version"]


def test_relighting_alone_is_the_same_version_with_fewer_needs():
    variant = tomllib.loads((ROOT / "relight/pyproject.toml").read_text())["project"]
    assert variant["version"] == f"{PROJECT['version']}+relight"
    for name in ("name", "requires-python", "license", "scripts"):
        assert variant[name] == PROJECT[name]
    assert set(variant["dependencies"]) < set(PROJECT["dependencies"])


def test_changelog_keeps_its_form():
    """Versions newest first, and under each only the headings that the form knows."""
    lines = (ROOT / "CHANGELOG.md").read_text().splitlines()
    versions = [line for line in lines if line.startswith("## ")]
    assert versions[0] == "## [Unreleased]"
    assert all(re.fullmatch(r"## \d+\.\d+\.\d+ - \d{4}-\d\d-\d\d", line) for line in versions[1:])
    kinds = {line for line in lines if line.startswith("### ")}
    known = ("Added", "Changed", "Deprecated", "Removed", "Fixed", "Security")
    assert kinds <= {f"### {kind}" for kind in known}


def guides() -> list[str]:
    (shelf,) = re.findall(
        r":caption: Guides\n.*?\n\n(.*?)```", (DOCS / "index.md").read_text(), re.S
    )
    return [name for name in shelf.split() if (DOCS / f"{name}.md").exists()]


@pytest.mark.parametrize("name", guides())
def test_guides_say_what_to_do_when_it_looks_wrong(name):
    text = (DOCS / f"{name}.md").read_text()
    assert re.search(r"^## (If it (looks wrong|does not work)|Where it fails)$", text, re.M)


# ------------------------------------------------------------------------------- supply chain


def required() -> set[str]:
    lists = [PROJECT["dependencies"], *PROJECT["optional-dependencies"].values()]
    names = {re.split(r"[\[<>=;~! ]", one)[0] for each in lists for one in each}
    return names - {"skylight-lighting"}


def supply_chain() -> dict[str, list[str]]:
    rows = re.findall(r"^\| ([\w@/.-]+) \| (.+) \|$", (DOCS / "supply_chain.md").read_text(), re.M)
    return {name: rest.split(" | ") for name, rest in rows if name != "package"}


def test_supply_chain_names_every_dependency():
    page = json.loads((ROOT / "studio/package.json").read_text())
    theirs = {*page["dependencies"], *page["devDependencies"]}
    assert set(supply_chain()) == required() | theirs
    assert all(len(row) == 3 and all(row) for row in supply_chain().values())


@pytest.mark.parametrize("name", sorted(required()))
def test_supply_chain_says_the_licence_that_the_package_declares(name):
    """By its expression, its short licence field or its classifiers; some declare none."""
    try:
        found = metadata(name)
    except PackageNotFoundError:
        pytest.skip(f"{name} is not installed")
    said = supply_chain()[name][1]
    if expression := found.get("License-Expression"):
        assert said in expression
        return
    texts = [(found.get("License") or "").partition("\n")[0].partition("(")[0].strip()]
    texts += [c.rpartition(":: ")[2] for c in found.get_all("Classifier") or [] if "License" in c]
    declared = {SPDX.get(text.lower(), text) for text in texts if len(text) < 60}
    if known := declared & set(SPDX.values()):
        assert said in known
    elif "BSD License" in declared:  # the classifier tells no clauses
        assert said.startswith("BSD-")


# ------------------------------------------------------------------------------- examples


def test_a_landmarker_of_ones_own(tmp_path, monkeypatch):
    """The page's program runs as it stands, and its points are those that are used."""
    text = (DOCS / "landmarks_card.md").read_text()
    (program,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    picture = astronaut()
    found = choose_landmarker().detect(picture)[0].points
    write_png(tmp_path / "portrait.png", picture)
    np.savetxt(tmp_path / "points.txt", found)
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(compile(program, "landmarks_card.md", "exec"), names)
    result = names["result"]
    np.testing.assert_allclose(result.face.points, found, atol=1e-6)
    assert result.estimate.light == "sh9"


@pytest.mark.slow
@pytest.mark.parametrize(
    "source", sorted((DOCS.parent / "examples").glob("*.py")), ids=lambda path: path.stem
)
def test_examples_import_what_they_name(source):
    """In a process of its own: what another test imported would hide what is missing."""
    load = f"import runpy; runpy.run_path({str(source)!r}, run_name='example')"
    done = subprocess.run([sys.executable, "-c", load], capture_output=True, text=True)
    # some read their arguments at once
    assert done.returncode == 0 or "sys.argv" in done.stderr, done.stderr


@pytest.mark.parametrize(
    "source", sorted(DOCS.glob("walkthroughs/*.py")), ids=lambda path: path.stem
)
def test_walkthroughs_stand_alone(source):
    """They name no folder of collected data, and begin with a title."""
    text = source.read_text()
    assert re.match(r'"""\n.+\n===', text)
    assert "shared" not in text


def test_formulas_are_known_to_the_builder():
    """What the site's extension cannot translate would stop its build."""
    latex2mathml = pytest.importorskip("docutils.utils.math.latex2mathml")
    formulas = []
    for page in [*DOCS.glob("*.md"), *DOCS.glob("concepts/*.md")]:
        text = re.sub(r"```.*?```|`[^`]*`", "", page.read_text(), flags=re.DOTALL)
        formulas += re.findall(r"\$\$(.+?)\$\$|\$([^$]+)\$", text, re.DOTALL)
    assert len(formulas) > 60
    for block, inline in formulas:
        latex2mathml.tex2mathml(block or inline, as_block=bool(block))
