"""Sphinx configuration of the documentation site, which `scripts/docs` builds with warnings as errors.

Pages are Markdown (MyST) and load nothing from other hosts.
"""

from __future__ import annotations

from importlib.metadata import version as version_of

from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx

project = "nomad-nserver"
author = "the nomad-nserver authors"
version = release = version_of("nomad-nserver")

# Markdown with $formulas$ (MathJax is part of the site), notebooks that are executed at each build, and the reference
# from numpydoc docstrings.
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax", "sphinx-mathjax-offline"]
myst_enable_extensions = ["dollarmath"]
napoleon_google_docstring = False
napoleon_use_rtype = False
default_role = "code"  # names in docstrings
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_class_signature = "mixed"
nb_execution_mode = "force"
nb_execution_excludepatterns = ["course/*"]  # tasks to be solved; tests run them with the solutions in
nb_execution_raise_on_error = True
nb_execution_timeout = 120
myst_heading_anchors = 3
nitpicky = True
nitpick_ignore_regex = [("py:.*", ".*")]  # types in signatures, of which most have no page

html_theme = "furo"
html_title = f"nomad-nserver {version}"
html_show_sourcelink = False
html_copy_source = False
html_static_path = ["_static"]
html_css_files = ["tables.css"]


def setup(app: Sphinx) -> None:
    """Show scripts of `nomad shell` as plain text."""
    app.add_lexer("nomad", TextLexer)
