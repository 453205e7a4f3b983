"""The documentation builds as a site without a warning; its executed pages are not run here."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT

pytest.importorskip("myst_nb")


def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    options = [
        "-W",
        "--keep-going",
        "-q",
        "-D",
        "nb_execution_mode=off",
        "-d",
        str(tmp_path / "kept"),
    ]
    built = subprocess.run(
        [sys.executable, "-m", "sphinx", *options, "-b", "html", "docs", str(tmp_path / "site")],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert built.returncode == 0, built.stderr
    named = {page.stem for page in (ROOT / "docs").glob("*.md")}
    assert named <= {page.stem for page in (tmp_path / "site").glob("*.html")}
