"""Sphinx builds the pages from Markdown, warnings as errors."""

project = "mdm"
author = "the mdm developers"
extensions = ["myst_parser"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = "mdm"
exclude_patterns = ["_build"]
