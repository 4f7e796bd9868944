# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""How `make docs` makes the pages: the texts of this folder, the notebooks, and the reference from the docstrings.

Nothing is fetched: no other project's index, no fonts, no scripts from elsewhere; equations are MathML.
"""

import logging
import os
import pathlib
import sys
import tempfile

DOCS = pathlib.Path(__file__).resolve().parent
sys.path[:0] = [str(DOCS.parent), str(DOCS)]

import pages  # noqa: E402

import hysteresis_ros  # noqa: E402

project = "hysteresis_ros"
author = "hysteresis_ros maintainers"
copyright = "2026, hysteresis_ros maintainers"
version = release = hysteresis_ros.__version__

extensions = ["sphinx.ext.autodoc", "sphinx.ext.autosummary", "numpydoc", "myst_nb"]
templates_path = ["templates"]
exclude_patterns = ["build", "**/.ipynb_checkpoints"]

# links to headings, as on the pages of the repository
myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath", "deflist"]

# notebooks are kept without results, and run when the pages are made
nb_execution_mode = "force"
nb_execution_timeout = 120
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True
nb_execution_in_temp = True
# kernels begin without the files of whoever makes the pages, and say only what is wrong
KERNELS = tempfile.TemporaryDirectory(prefix="hysteresis_")
os.environ["IPYTHONDIR"] = KERNELS.name
(pathlib.Path(KERNELS.name) / "profile_default").mkdir()
(pathlib.Path(KERNELS.name) / "profile_default" / "ipython_kernel_config.py").write_text(
    "get_config().IPKernelApp.log_level = 40\n", encoding="utf-8"
)
logging.getLogger("traitlets").setLevel(logging.WARNING)

autosummary_generate = True
autosummary_ignore_module_all = False
autodoc_typehints = "none"
autodoc_member_order = "bysource"
# members are documented below their class, not once more in tables of numpydoc
numpydoc_show_class_members = False

html_theme = "furo"
html_title = f"hysteresis_ros {release}"
html_math_renderer = "mathml"
html_copy_source = False
html_static_path = ["static"]
html_css_files = ["tables.css"]
html_theme_options = {"source_repository": pages.REPOSITORY, "source_branch": "main", "source_directory": "docs/"}


def setup(app):
    """Write the pages of the reference before they are read, and connect what the texts need."""
    pages.write_reference(DOCS / "reference")
    pages.connect(app)
