"""Sphinx configuration: furo, pages in Markdown, autodoc of the public names. No code is run."""

import re

from docutils.nodes import SkipNode
from latex2mathml.converter import convert

from kempe import __version__

project = "Kempe"
author = "The Kempe authors"
copyright = author
version = release = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
napoleon_google_docstring = False
napoleon_use_ivar = True  # attributes are listed once, by autodoc
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = f"Kempe {version}"
html_static_path = ["_static"]
html_css_files = ["kempe.css"]

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
suppress_warnings = [
    "toc.not_included",  # pages of models: the gallery leads to them
    "ref.python",  # names of attributes that several classes have
]
html_math_renderer = "mathml"

default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
add_module_names = False
toc_object_entries_show_parents = "hide"
python_use_unqualified_type_names = True

_LITERAL = re.compile(r"(``[^`]+``|`[^`]+`)")


def _plain(app, what, name, obj, options, lines):
    """Docstrings are plain text with code in backticks: other characters mean nothing to
    reStructuredText, but in examples, which end with an empty line.
    """
    is_example = False
    for k, line in enumerate(lines):
        is_example = line.lstrip().startswith(">>>") or (is_example and bool(line.strip()))
        if not is_example:
            lines[k] = "".join(
                part if part.startswith("`") else re.sub(r"([*|_])", r"\\\1", part)
                for part in _LITERAL.split(line)
            )


def _write_formula(translator, node):
    """Write a formula as MathML, which browsers show without a script and without the network."""
    display = "inline" if node.tagname == "math" else "block"
    translator.body.append(convert(node.astext(), display=display))
    raise SkipNode


def setup(app):
    """Connect the hooks."""
    app.add_html_math_renderer("mathml", (_write_formula, None), (_write_formula, None))
    # before napoleon, which makes reStructuredText of the sections
    app.connect("autodoc-process-docstring", _plain, priority=400)
