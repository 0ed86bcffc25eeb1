"""Sphinx configuration: furo, pages in Markdown, autodoc of the public names. No code is run."""

import re
from pathlib import Path

from docutils.nodes import SkipNode
from latex2mathml.converter import convert

from kempe import __version__

project = "Kempe"
author = "The Kempe authors"
copyright = author
version = release = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
napoleon_google_docstring = False
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = f"Kempe {version}"
html_static_path = ["_static"]
html_css_files = ["kempe.css"]

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
html_math_renderer = "mathml"

default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
add_module_names = False
python_use_unqualified_type_names = True

_LITERAL = re.compile(r"(``[^`]+``|`[^`]+`)")
_GLOSSARY = (
    Path(__file__).with_name("glossary.md").read_text(encoding="utf-8").partition("{glossary}\n")[2]
)
_TERMS = {t.lower(): t for t in re.findall(r"^\w.*", _GLOSSARY, re.MULTILINE) if len(t) > 7}
"""Terms that docstrings link to: short ones are ordinary words, too."""
_TERM = re.compile(
    rf"(?<![\w-])({'|'.join(sorted(_TERMS, key=len, reverse=True))})s?(?![\w-])", re.IGNORECASE
)


def _linked(text, seen):
    """Text whose terms link to the glossary, each where it is first seen."""

    def link(match):
        term = match[1].lower()
        if term in seen:
            return match[0]
        seen.add(term)
        return f":term:`{match[0]} <{_TERMS[term]}>`"

    return _TERM.sub(link, text)


def _plain(app, what, name, obj, options, lines):
    """Docstrings are plain text with code in backticks: other characters mean nothing to
    reStructuredText.
    """
    seen = set()
    lines[:] = [
        "".join(
            part if part.startswith("`") else _linked(re.sub(r"([*|_])", r"\\\1", part), seen)
            for part in _LITERAL.split(line)
        )
        if ">>>" not in line and not line.startswith("    ")
        else line
        for line in lines
    ]


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
