"""Sphinx configuration of the documentation site, which `scripts/docs` builds with warnings as errors.

Pages are Markdown (MyST) and load nothing from other hosts.
"""

from __future__ import annotations

from importlib.metadata import version as version_of
from typing import Any

from docutils import nodes
from pygments.lexers.special import TextLexer
from sphinx.addnodes import toctree
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


def title_of_page(toc: nodes.Element) -> nodes.Element:
    """Return the contents of a page without its sections: the title, and the lists of pages below it."""
    title = toc.deepcopy()
    for item in title.children:
        if isinstance(item, nodes.Element) and len(item) > 1:
            item[1:] = [nodes.bullet_list("", *pages)] if (pages := list(item.findall(toctree))) else []
    return title


def setup(app: Sphinx) -> None:
    """Show scripts of `nomad shell` as plain text, and make the sidebar from titles."""
    app.add_lexer("nomad", TextLexer)
    titles: dict[str, nodes.Element] = {}

    def make_from_titles(_app: Sphinx, _page: str, _template: str, context: dict[str, Any], _tree: object) -> None:
        """Let the theme make a page's sidebar from titles: it copies the sections of all pages, and drops them."""
        make = context["toctree"]

        def make_sidebar(**options: Any) -> str:
            contents = app.env.tocs
            titles.update({name: title_of_page(toc) for name, toc in contents.items() if name not in titles})
            app.env.tocs = titles
            try:
                return str(make(**options))
            finally:
                app.env.tocs = contents

        context["toctree"] = make_sidebar

    app.connect("html-page-context", make_from_titles, priority=400)
