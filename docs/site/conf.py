"""Settings of Sphinx; `python docs/site/build.py` gives it the pages."""

from importlib.metadata import version

project = "parapod"
author = "the authors of parapod"
release = version = version("parapod")
extensions = ["myst_nb", "sphinx_design"]
myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 4
# Notebooks are executed once, and again only where they have changed.
nb_execution_mode = "cache"
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_merge_streams = True
nitpicky = True
html_theme = "furo"
html_title = "parapod"
pygments_dark_style = "github-dark"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_show_sphinx = False
html_copy_source = False
html_show_copyright = False
html_theme_options = {"navigation_with_keys": True}
# Blocks of commands show what is printed as well, which is no shell.
suppress_warnings = ["misc.highlighting_failure"]
