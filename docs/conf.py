"""Settings of the site; ``python docs/build.py`` builds it, see there."""

import os
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "_ext")]

import generate  # noqa: E402

from mitsuba_bezier import __version__  # noqa: E402

project = "mitsuba_bezier"
author = "The mitsuba_bezier authors"
copyright = author
release = version = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",  # NumPy docstrings
    "sphinx_design",  # the doors of the landing page
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
    "site_pages",  # ours: docs/_ext
]
# the lecture is cut into pages: docs/_ext/generate.py
exclude_patterns = ["_build", "_ext", "examples", "notebooks", "figures", "lecture.md"]
root_doc = "index"

html_theme = "furo"
html_title = "mitsuba_bezier"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False  # the pages are in the repository
html_theme_options = {"navigation_with_keys": True}
templates_path: list[str] = []

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
html_math_renderer = "mathml"  # ours: browsers draw it without a script from elsewhere
myst_heading_anchors = 4  # links to sections, as on the pages of a repository
# figures of tables, such as C1, are no list of names
myst_links_external_new_tab = False

# Docstrings write names in single backticks, as plain code.
default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # types stand in the docstrings, in words
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
napoleon_preprocess_types = False

nitpicky = True
# Types in docstrings are words, such as "array of shape (P, 3)", and names of other packages, whose
# pages are not asked for: the build uses no network.
nitpick_ignore_regex = [("py:.*", ".*")]

sphinx_gallery_conf = {
    "examples_dirs": "examples",
    "gallery_dirs": "gallery",
    "image_scrapers": ("site_pages.pictures",),  # by name, as Sphinx keeps the settings
    "abort_on_example_error": True,
    "remove_config_comments": True,
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "min_reported_time": 1e6,  # of a machine with other work they say nothing
    "thumbnail_size": (400, 262),
    "write_computation_times": False,  # its page loads scripts from elsewhere
    "within_subsection_order": "ExampleTitleSortKey",
    # the tests build the pages without running the scripts, which takes minutes
    "plot_gallery": os.environ.get("MITSUBA_BEZIER_GALLERY", "1") != "0",
}

copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

generate.all_pages(HERE / "generated")
