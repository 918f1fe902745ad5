"""The documentation site: Sphinx, MyST and furo. ``make docs`` builds it."""

from __future__ import annotations

import os
import sys
from pathlib import Path

DOCS = Path(__file__).parent
ROOT = DOCS.parent
sys.path.insert(0, str(ROOT))
os.environ["PYTHONPATH"] = str(ROOT)  # of the kernels that run the tutorials

from docs.pages.docstrings import register_docstrings  # noqa: E402
from docs.pages.mathematics import register_mathematics  # noqa: E402
from docs.pages.write import write_pages  # noqa: E402
from impact_envs import __version__  # noqa: E402

project = "impact-envs"
release = __version__
copyright = "the impact-envs developers"
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
exclude_patterns = ["build", "pages", "generated/*.txt", "generated/static"]
highlight_language = "text"  # of blocks without a language: commands and formulas

html_theme = "furo"
html_title = "impact-envs"
html_static_path = ["style", "generated/static"]
html_css_files = ["site.css"]
smartquotes = False  # --option stays what it is
html_math_renderer = "mathml"
html_copy_source = False
html_show_sphinx = False

myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 4
# Tutorials are run when the site is built, and anew only when they change; the slow tests run them, too.
nb_execution_mode = "off" if os.environ.get("DOCS_EXECUTE") == "0" else "cache"
nb_execution_timeout = 900
nb_execution_raise_on_error = True
nb_execution_in_temp = True
nb_execution_cache_path = str(DOCS / "build" / "executed")
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_class_signature = "mixed"
toc_object_entries_show_parents = "hide"
napoleon_google_docstring = True
napoleon_use_rtype = False


def setup(app: object) -> None:
    """Write the generated pages before Sphinx looks for files."""
    write_pages()
    register_docstrings(app)
    register_mathematics(app)
