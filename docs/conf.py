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
    "generator.figures",
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
# The colours and the type of the page that the service shows at /.
_TYPE = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", sans-serif'
_MONO = 'ui-monospace, "SF Mono", "Cascadia Code", "DejaVu Sans Mono", Menlo, Consolas, monospace'
_LIGHT = {
    "font-stack": _TYPE,
    "font-stack--monospace": _MONO,
    "color-brand-primary": "#14568f",
    "color-brand-content": "#14568f",
    "color-brand-visited": "#14568f",
    "color-background-primary": "#fbfaf7",
    "color-background-secondary": "#f1efe9",
    "color-background-border": "#dcd8cf",
    "color-foreground-primary": "#1c2430",
    "color-foreground-secondary": "#566070",
    "color-foreground-muted": "#566070",
}
_DARK = {
    "color-brand-primary": "#8ec5ff",
    "color-brand-content": "#8ec5ff",
    "color-brand-visited": "#8ec5ff",
    "color-background-primary": "#12161c",
    "color-background-secondary": "#1a2028",
    "color-background-border": "#2f3944",
    "color-foreground-primary": "#e8eaee",
    "color-foreground-secondary": "#a3adba",
    "color-foreground-muted": "#a3adba",
}
html_theme_options = {
    "navigation_with_keys": True,
    "light_css_variables": _LIGHT,
    "dark_css_variables": _DARK,
    "light_logo": "favicon.svg",
    "dark_logo": "favicon.svg",
}
templates_path = [str(DOCS / "templates")]
_SIDEBAR = ("brand", "page", "search", "scroll-start", "navigation", "scroll-end")
html_sidebars = {"**": [f"sidebar/{part}.html" for part in _SIDEBAR]}

# The same label for the same lines: `$ ` is no part of a command.
copybutton_exclude = ".linenos, .gp, .go"
