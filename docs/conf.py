"""Sphinx configuration: furo, MyST pages whose code cells are run, autodoc of the public names."""

import os
import re
import sys
from pathlib import Path

from kempe import __version__

os.environ["KEMPE_QUIET"] = "1"  # the notice about compilation belongs to no page

project = "Kempe"
author = "The Kempe authors"
copyright = author
version = release = __version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
napoleon_google_docstring = False
exclude_patterns = ["_build", "jupyter_execute"]
html_theme = "furo"
html_title = f"Kempe {version}"
html_static_path = ["_static"]
html_css_files = ["kempe.css"]

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 120
nb_execution_in_temp = True
nb_merge_streams = True

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


def _pictures(app):
    """Draw the pictures of the gallery, which the repository does not keep."""
    sys.path.insert(0, str(Path(__file__).parent))
    from gallery_page import draw

    draw()


def setup(app):
    """Connect the hooks."""
    app.connect("builder-inited", _pictures)
    # before napoleon, which makes reStructuredText of the sections
    app.connect("autodoc-process-docstring", _plain, priority=400)
