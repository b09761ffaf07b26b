"""Settings of Sphinx for the site; read by ``python -m docs.site``."""

import tomllib
from pathlib import Path

_PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))["project"]

project = _PROJECT["name"]
version = release = _PROJECT["version"]
author = project_copyright = "The slipangle authors"
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "docs.site.mathml",
    "docs.site.docstrings",
]
suppress_warnings = ["config.cache"]

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
source_suffix = {".md": "markdown"}

default_role = "code"  # a name in single backticks of a docstring
autodoc_typehints = "none"  # docstrings say types, with shapes and units
autodoc_preserve_defaults = True
napoleon_google_docstring = False
napoleon_use_rtype = napoleon_use_param = False  # types are words with shapes, not names to link
napoleon_preprocess_types = False

highlight_language = "none"
html_math_renderer = "mathml"
html_theme = "furo"
html_title = "slipangle"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_show_sphinx = False
html_copy_source = False
html_theme_options = {"navigation_with_keys": True}
pygments_style, pygments_dark_style = "friendly", "monokai"
