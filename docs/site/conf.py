"""Settings of Sphinx; `python docs/site/build.py` gives it the pages."""

import re
from importlib.metadata import version
from typing import Any

project = "parapod"
author = "the authors of parapod"
release = version = version("parapod")
extensions = ["myst_nb", "sphinx_design"]
myst_enable_extensions = ["amsmath", "colon_fence", "dollarmath"]
# As on GitHub: `$ command` and `$5` are not formulas.
myst_dmath_allow_space = False
myst_dmath_allow_digits = False
# Formulas are MathML, which browsers typeset by themselves: no script, no fonts, no network.
html_math_renderer = "mathml"
myst_heading_anchors = 4
# Notebooks are executed once, and again only where they have changed.
nb_execution_mode = "cache"
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_merge_streams = True
nitpicky = True
html_theme = "furo"
html_title = "parapod"
pygments_dark_style = "github-dark"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_show_sphinx = False
html_copy_source = False
html_show_copyright = False
html_theme_options = {"navigation_with_keys": True}
# Blocks of commands show what is printed as well, which is no shell.
suppress_warnings = ["misc.highlighting_failure"]

_NUMBERED = re.compile(r"\{(align|equation|gather|multline)\}")


def setup(app: Any) -> None:
    """Adds the renderer of formulas; Sphinx calls this."""
    app.add_html_math_renderer("mathml", (_inline_math, None), (_block_math, None))


def mathml(latex: str, is_block: bool) -> str:
    """A formula as MathML.

    Args:
        latex: formula in LaTeX.
        is_block: true if it stands on lines of its own.

    Raises:
        LatexError: the formula has an unknown command or a mistake.
    """
    from math_core import LatexToMathML

    # Sphinx numbers blocks as a whole, not their lines.
    latex = _NUMBERED.sub(r"{\1*}", latex)
    # Aligned lines in one block need an environment, as they do in LaTeX.
    if is_block and "\\\\" in latex and "\\begin{" not in latex:
        latex = f"\\begin{{aligned}}{latex}\\end{{aligned}}"
    converter = LatexToMathML(fancy_error=False)
    return str(converter.convert_with_local_state(latex, displaystyle=is_block))


def _inline_math(translator: Any, node: Any) -> None:
    _render(translator, node, False)


def _block_math(translator: Any, node: Any) -> None:
    from sphinx.util.math import get_node_equation_number

    translator.body.append(translator.starttag(node, "div", CLASS="formula"))
    if node["number"]:
        number = get_node_equation_number(translator, node)
        translator.body.append(f'<span class="eqno">({number})</span>')
    _render(translator, node, True)


def _render(translator: Any, node: Any, is_block: bool) -> None:
    from docutils.nodes import SkipNode
    from math_core import LatexError
    from sphinx.util import logging

    try:
        translator.body.append(mathml(node.astext(), is_block))
    except LatexError as error:
        says = f"cannot typeset {node.astext()!r}: {error}"
        logging.getLogger(__name__).warning(says, location=node)
    if is_block:
        translator.body.append("</div>\n")
    raise SkipNode
