"""Formulas as MathML in the page itself: no script, no font and no network, and screen readers
speak it. Browsers draw it since 2023. docutils translates LaTeX; what it does not know stops the
build.
"""

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator


def inline(translator: HTML5Translator, node: nodes.Element) -> None:
    translator.body.append(tex2mathml(node.astext(), as_block=False))
    raise nodes.SkipNode


def block(translator: HTML5Translator, node: nodes.Element) -> None:
    number = ""
    if node["number"]:
        label = node["docname"] + ":" + node["label"]
        number = f'<span class="eqno">({node["number"]})</span>'
        translator.body.append(f'<div class="math" id="equation-{node["label"]}" title="{label}">')
    else:
        translator.body.append('<div class="math">')
    translator.body.append(number + tex2mathml(node.astext(), as_block=True) + "</div>")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
