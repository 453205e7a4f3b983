"""Public names, what they cost, what may be cited, and the code of the pages, which runs."""

from __future__ import annotations

import inspect
import re
import tomllib
from pathlib import Path

import pytest
import xarray as xr
from fresh_process import loaded_by
from places import ROOT

import bayesbl
from bayesbl import cli
from bayesbl.cli.commands import compare_command, diagnose_command, fit_command, identify_command
from bayesbl.errors import ResultError
from bayesbl.presentation.console import all_bibtex
from bayesbl.results.store import write_tree

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
CODE = re.compile(r"^```(?:python|\{code-cell\}.*?)\n(?::.*?\n)*(.*?)^```", re.S | re.M)
PYTHON = {
    page.name: "\n".join(blocks)
    for page in PAGES
    # Pieces of files; what takes long runs when the site is built.
    if page.name not in ("extending.md", "gallery.md")
    if "%%sh" not in (text := page.read_text(encoding="utf-8"))
    if (blocks := CODE.findall(text))
}
"""Page to its code: later blocks go on from earlier ones."""


def test_every_public_name_is_there_and_documented():
    for name in bayesbl.__all__:
        found = getattr(bayesbl, name)
        if name != "__version__":
            assert found.__doc__, name
            assert f"``{name}``" in bayesbl.__doc__ or f"``{name}``" in bayesbl.__doc__.replace(
                "a ``Bench``;", "``Bench``"
            )
    assert set(bayesbl.__all__) <= set(dir(bayesbl))
    with pytest.raises(AttributeError, match="no_such_thing"):
        _ = bayesbl.no_such_thing


def test_importing_the_package_imports_nothing_else():
    heavy = {"numpy", "xarray", "pydantic", "jinja2", "rich", "typer"}
    assert not loaded_by("import bayesbl") & heavy


def test_types_and_templates_are_shipped():
    data = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    patterns = data["package-data"]["bayesbl"]
    package = ROOT / "bayesbl"
    shipped = {path for pattern in patterns for path in package.glob(pattern)}
    assert package / "py.typed" in shipped
    for file in package.rglob("*"):
        if file.suffix in (".html", ".css", ".toml"):
            assert file in shipped


@pytest.mark.long
@pytest.mark.parametrize("page", PYTHON)
def test_the_python_of_the_documentation_runs(page, monkeypatch, tmp_path):
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    monkeypatch.chdir(tmp_path)
    exec(compile(PYTHON[page], page, "exec"), {"__name__": "page"})


def test_functions_take_what_their_commands_take():
    taken = {
        name: set(inspect.signature(getattr(bayesbl, name)).parameters)
        for name in ("fit", "compare", "identify", "diagnose")
    }
    commands = {"fit": fit_command, "compare": compare_command}
    commands |= {"identify": identify_command, "diagnose": diagnose_command}
    for name, command in commands.items():
        options = set(inspect.signature(command).parameters) - {"out", "force", "json", "inputs"}
        assert taken[name] - options <= {"recordings", "progress"}
        assert options <= taken[name]


def test_the_paper_and_every_tool_are_cited(capsys):
    assert cli.status(["cite"]) == 0
    printed = capsys.readouterr().out
    for work in ("Backlash Gap in Industrial Manipulators", "Hansen", "Foreman-Mackey", "ArviZ"):
        assert work in printed
    assert bayesbl.__version__ in printed
    assert printed.strip() == all_bibtex()


def test_bibtex_entries_are_whole():
    for entry in all_bibtex().split("\n\n"):
        assert entry.count("{") == entry.count("}")
        assert re.match(r"@\w+\{\w+,\n", entry)
        assert "\n  title = {" in entry
        assert "\n  annote = {" in entry


def test_a_result_of_a_later_versions_kind_is_refused(tmp_path: Path) -> None:
    """Its seal and its layout are as they should be."""
    tree = xr.DataTree()
    tree.attrs = {"kind": "oracle", "outcome": "converged"}
    write_tree(tree, tmp_path / "result.nc")
    with pytest.raises(ResultError, match="kind of this result is unknown"):
        bayesbl.read_result(tmp_path)
