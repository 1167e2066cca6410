"""How the site is built: ``make docs``."""

from __future__ import annotations

import sys
from pathlib import Path

import coopqp

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))

project = "coopqp"
author = "The coopqp maintainers"
version = release = coopqp.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
    "coopqp_site.extension",
]
exclude_patterns = ["_ext", "gallery/**.ipynb", "gallery/**.py"]

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
html_math_renderer = "mathml"

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
toc_object_entries = False

sphinx_gallery_conf = {
    "examples_dirs": "../examples/gallery",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    "plot_gallery": "True",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_signature": False,
    "within_subsection_order": "coopqp_site.gallery.Order",
    "write_computation_times": False,
    "min_reported_time": 3600,  # [s], so that pages do not tell how long they took
}

html_theme = "furo"
html_title = f"coopqp {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_search_scorer = str(HERE / "search_scorer.js")
html_show_copyright = False
html_show_sphinx = False
html_copy_source = False
html_show_sourcelink = False
