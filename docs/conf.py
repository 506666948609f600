"""How the site is built: scripts/docs. Pages are Markdown (MyST); every warning is an error.

Rules: nothing is loaded from elsewhere when a page is read, and a page that no list names is an error.
"""

from __future__ import annotations

from importlib.metadata import version as version_of

from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx

project = "nomad-nserver"
author = "the nomad-nserver authors"
version = release = version_of("nomad-nserver")

extensions = ["myst_nb"]  # Markdown, and notebooks that are run anew each time
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 120
myst_heading_anchors = 3
nitpicky = True

html_theme = "furo"
html_title = f"nomad-nserver {version}"
html_show_sourcelink = False
html_copy_source = False
html_static_path = ["_static"]
html_css_files = ["tables.css"]


def setup(app: Sphinx) -> None:
    """Scripts of `nomad shell` are shown as they are."""
    app.add_lexer("nomad", TextLexer)
