"""Sphinx builds the pages from Markdown, warnings as errors; those of the reference are made from the code before."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import generated

generated.write()

project = "mdm"
author = "the mdm developers"
extensions = ["myst_parser"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = "mdm"
exclude_patterns = ["_build"]
html_static_path = ["_static"]
html_css_files = ["pages.css"]
