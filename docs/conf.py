"""Settings of Sphinx for the documentation site, which ``make docs`` builds."""

import importlib
import re
from importlib.util import find_spec

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

from tools.api_page import MODULES, ROOT

project = "mirdrake"
author = "the authors of mirdrake"
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_design", "sphinx_copybutton"]
exclude_patterns = ["jupyter_execute"]

html_theme = "furo"
html_title = "mirdrake"
html_static_path = ["."]
html_css_files = ["site.css"]
html_extra_path = ["film.html"]  # a page of its own within the gallery
html_show_sphinx = False
html_copy_source = False
html_math_renderer = "mathml"

myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_dmath_double_inline = True  # formulas within a paragraph of a notebook
myst_heading_anchors = 4

nb_execution_mode = "cache"
nb_execution_cache_path = str(ROOT / "build" / "notebook_outputs")
nb_execution_timeout = 900
nb_execution_raise_on_error = True
nb_merge_streams = True
# Notebooks of packages that the extra [docs] does not install are shown without outputs where these are missing.
NEEDS = {"tutorials/12_*": "torch", "tutorials/13_*": "stable_baselines3"}
nb_execution_excludepatterns = [pattern for pattern, package in NEEDS.items() if find_spec(package) is None]

autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
# Fields of a dataclass are listed once, with their text from "Attributes".
napoleon_use_ivar = True
napoleon_custom_sections = [("Input ports", "params_style"), ("Output ports", "params_style")]


def write_math(translator: HTML5Translator, node: nodes.math) -> None:
    """Write a formula in a line as MathML, which browsers show without a script or a network."""
    translator.body.append(convert(node.astext()))
    raise nodes.SkipNode


def write_math_block(translator: HTML5Translator, node: nodes.math_block) -> None:
    """Write a formula in a paragraph of its own as MathML."""
    translator.body.append(f'<div class="math">{convert(node.astext(), display="block")}</div>')
    raise nodes.SkipNode


def escape_bars(*event: object) -> None:
    """Escape the bars of magnitudes in a docstring, as in |x|, which would be references to substitutions."""
    lines = event[-1]
    assert isinstance(lines, list)
    for number, line in enumerate(lines):
        parts = re.split(r"(``.*?``|`.*?`)", line)
        lines[number] = "".join(part if part.startswith("`") else part.replace("|", r"\|") for part in parts)


def setup(app: Sphinx) -> None:
    """Register the renderer of formulas and the change of docstrings."""
    app.add_html_math_renderer("mathml", (write_math, None), (write_math_block, None))
    app.connect("autodoc-process-docstring", escape_bars)


# Before autodoc, whose own import changes what pydantic reads of annotations.
for module in MODULES:
    importlib.import_module(f"mirdrake.{module}")
