"""The documentation's site: ``make docs``; ``WALK=1`` runs its walk-throughs."""

import os
import sys
from importlib.metadata import version as installed
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]  # mathml, drawings; the package itself

import drawings  # noqa: E402
from sphinx.application import Sphinx  # noqa: E402

from tools import build_measurements  # noqa: E402

project = "skylight"
author = "the skylight authors"
copyright = author
release = version = installed("skylight-lighting")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
    "mathml",
]
exclude_patterns = ["_build", "_templates", "walkthroughs", "sg_execution_times.rst"]
templates_path = ["_templates"]
html_copy_source = False
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_theme = "furo"
html_title = "skylight"
html_math_renderer = "mathml"
html_theme_options = {"navigation_with_keys": True}
pygments_style = "default"

myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "colon_fence", "attrs_block"]
myst_heading_anchors = 3
myst_dmath_double_inline = True

autosummary_generate = True
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_use_type_comments = False  # there are none
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_param = False  # what follows a name describes it: no word of it is a type to look for

sphinx_gallery_conf = {
    "examples_dirs": "walkthroughs",
    "gallery_dirs": "_walkthroughs",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "remove_config_comments": True,
    "show_memory": False,
    "write_computation_times": False,  # its page would load a script from elsewhere
    "show_signature": False,
    "image_scrapers": ("matplotlib",),
    "matplotlib_animations": False,
    "plot_gallery": os.environ.get("WALK") == "1",
}

drawings.write(HERE / "_drawings")
build_measurements.write(HERE / "measurements.md")


def open_one_branch(app: Sphinx, page: str, template: str, context: dict, _: object) -> None:
    """The sidebar opens only where the page is: all modules on every page are half of the work."""
    whole = context["toctree"]
    context["toctree"] = lambda **options: whole(**options | {"collapse": True})


def setup(app: Sphinx) -> None:
    app.connect("html-page-context", open_one_branch, priority=400)  # before the theme, at 500
