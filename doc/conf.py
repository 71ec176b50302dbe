"""Settings of Sphinx, which rosdoc2 uses too: `make doc` builds build/doc/index.html."""

from pathlib import Path
import re

SETUP = (Path(__file__).resolve().parent.parent / 'setup.py').read_text()

project = 'inverse_dynamics_node'
author = 'inverse_dynamics_node maintainers'
version = release = re.search("version='(.*)'", SETUP)[1]
copyright = f'2026, {author}'  # noqa: A001
extensions = ['myst_parser', 'sphinx.ext.autodoc', 'sphinx.ext.napoleon']
autodoc_typehints = 'none'  # the docstrings have the types
autodoc_member_order = 'bysource'
myst_heading_anchors = 4
# Files outside of this folder are not part of the site; test/test_markdown.py checks all links.
suppress_warnings = ['myst.xref_missing', 'ref.citation']
html_theme = 'alabaster'
html_theme_options = {'description': 'Joint torques from a URDF, in ROS 2', 'page_width': '1200px'}
