"""Sphinx configuration: furo, MyST pages whose code cells are run, autodoc of the public names."""

import os
import re

from kempe import __version__

os.environ["KEMPE_QUIET"] = "1"  # the notice about compilation belongs to no page

project = "Kempe"
author = "The Kempe authors"
copyright = author
version = release = __version__

extensions = ["myst_nb", "sphinx.ext.autodoc"]
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


def _escape(app, what, name, obj, options, lines):
    """Docstrings are plain text with code in backticks: other characters mean nothing to reStructuredText."""
    lines[:] = [
        "".join(part if part.startswith("`") else re.sub(r"([*|_])", r"\\\1", part) for part in _LITERAL.split(line))
        if ">>>" not in line and not line.startswith("    ")
        else line
        for line in lines
    ]


def setup(app):
    """Connect the hook."""
    app.connect("autodoc-process-docstring", _escape)
