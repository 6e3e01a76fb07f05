"""Sphinx settings; `make docs` builds with warnings as errors."""

from boxgrasp import __version__

project = "boxgrasp"
author = "the boxgrasp authors"
project_copyright = "the boxgrasp authors, Apache-2.0"
version = release = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax"]
exclude_patterns = ["_build"]
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
autodoc_typehints = "description"
autodoc_member_order = "bysource"
autodoc_class_signature = "separated"
html_theme = "furo"
html_title = "boxgrasp"
html_show_sphinx = False
