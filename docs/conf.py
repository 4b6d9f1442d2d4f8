"""The settings of Sphinx for the site. `deploy/site` builds it."""

from __future__ import annotations

import sys
from importlib.metadata import version as version_of
from pathlib import Path

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS))

project = "equimesh"
version = release = version_of("equimesh")
language = "en"
html_title = f"equimesh {release}"

extensions = [
    "myst_parser",
    "sphinx_copybutton",
    "sphinx.ext.autodoc",
    "generator.mathml",
    "generator.names",
    "generator.inline",
]
nitpicky = True

# Markdown as the pages are written: anchors as in a git viewer, formulas between dollar signs.
myst_enable_extensions = ["dollarmath", "html_image"]
myst_heading_anchors = 4
myst_dmath_double_inline = True

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 80
add_module_names = False
toc_object_entries_show_parents = "hide"

html_theme = "furo"
html_static_path = [str(DOCS / "style")]
html_css_files = ["site.css"]
html_favicon = str(DOCS / "style" / "favicon.svg")
html_math_renderer = "mathml"
html_copy_source = False
html_show_sourcelink = False
html_show_copyright = False
html_last_updated_fmt = None
html_theme_options = {"navigation_with_keys": True}
templates_path = [str(DOCS / "templates")]

# The same label for the same lines: `$ ` is no part of a command.
copybutton_exclude = ".linenos, .gp, .go"
