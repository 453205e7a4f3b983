"""The documentation as a site: ``python -m sphinx -W -b html docs build/docs``."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS.parent))

import bayesbl  # noqa: E402

# What the executed pages find: the commands, and a start of their own.
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
os.environ["PYTHONPATH"] = str(DOCS.parent)
os.environ["PYTHONSTARTUP"] = str(DOCS / "kernel_start.py")

# The command line tells of itself.
TELL = "-m typer bayesbl.cli utils docs --name bayesbl --title Commands"
told = subprocess.run(
    [sys.executable, *shlex.split(TELL)],
    check=True,
    capture_output=True,
    text=True,
)
(DOCS / "command_line.md").write_text(told.stdout, encoding="utf-8")

project = "bayesbl"
author = "The bayesbl founders"
release = version = bayesbl.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
exclude_patterns = ["schema"]

myst_heading_anchors = 4

nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = -1  # a machine may be busy
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
napoleon_custom_sections = ["Returns"]  # prose: the type stands in the signature

html_theme = "furo"
html_static_path = ["static"]
html_css_files = ["tables.css"]
html_title = f"bayesbl {version}"
html_show_copyright = False
html_show_sourcelink = False
