"""How the package is built: rooms import downwards, no circles, sentences where they belong."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from places import ROOT

PACKAGE = ROOT / "bayesbl"

FLOW = {
    "tools of every room": """errors arguments units declared libraries processes
        progress probabilities compiled""",
    "recordings, and the virtual bench": "recording noise bench sampling",
    "optimum and posterior": "ramps two_encoders ringing matching",
    "which laws explain a misfit": "model_search",
    "curve, configuration, result files": "curve config results",
    "gap and change": "measurement sentences",
    "what a bench lacks, and many joints": "diagnosis identification fleet",
    "runs, and the report": "runs presentation library cli __main__",
}
"""Data flow from recording to report: a room imports from itself and from those before it."""

# The package itself holds its version, and looks its public names up when asked for.
ROOMS = ("bayesbl", *" ".join(FLOW.values()).split())


def files() -> dict[str, Path]:
    """Every module of the package by its name, without the leading ``bayesbl.``."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        found[".".join(p for p in parts if p != "__init__") or "bayesbl"] = path
    return found


def imported(tree: ast.AST, modules: Mapping[str, object]) -> set[str]:
    """Modules of the package that some code imports, for types too, wherever in it that stands."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, "imports state the whole name"
            for alias in node.names:
                inside = f"{node.module}.{alias.name}"
                is_module = inside.removeprefix("bayesbl.") in modules
                found.add(inside if is_module else node.module or "")
    of_package = {name for name in found if name.split(".")[0] == "bayesbl"}
    return {name.removeprefix("bayesbl.") for name in of_package}


@pytest.fixture(scope="module")
def imports() -> dict[str, set[str]]:
    """For every module those that it imports, in functions and for types too.

    But for the package itself, which only hands names on, each when it is asked for.
    """
    modules = files()
    return {
        name: imported(ast.parse(path.read_text(encoding="utf-8")), modules)
        for name, path in modules.items()
        if name != "bayesbl"
    }


def room(module: str) -> int:
    return ROOMS.index(module.split(".")[0])


def circles(graph: Mapping[str, set[str]]) -> set[tuple[str, ...]]:
    """One circle after the other, each without its last import once it is found."""
    open_graph, found = {name: set(targets) for name, targets in graph.items()}, set()
    while True:
        try:
            TopologicalSorter(open_graph).prepare()
        except CycleError as error:
            *circle, _ = error.args[1]  # each imported by the one behind it
            open_graph[circle[1 % len(circle)]].discard(circle[0])
            found.add(tuple(sorted(circle)))
        else:
            return found


def test_every_import_is_found():
    code = """
import bayesbl.units
from bayesbl import errors, __version__
from typing import TYPE_CHECKING
if TYPE_CHECKING:
    from bayesbl.cli import main
def late():
    from bayesbl.bench.kernel import run
    import numpy
"""
    found = imported(ast.parse(code), {"errors": 0, "bench.kernel": 0})
    assert found == {"units", "errors", "bayesbl", "cli", "bench.kernel"}


def test_circles_are_found():
    graph = {"a": {"b"}, "b": {"c"}, "c": {"a", "d"}, "d": {"e"}, "e": {"d"}, "f": {"f"}}
    assert circles(graph) == {("a", "b", "c"), ("d", "e"), ("f",)}


def test_every_room_has_its_place():
    assert {name.split(".")[0] for name in files()} == set(ROOMS)


def test_imports_go_downwards(imports):
    upwards = {
        (module, target)
        for module, targets in imports.items()
        for target in targets
        if room(target) > room(module)
    }
    assert not upwards


def test_no_file_imports_itself_over_others(imports):
    assert not circles(imports)


def test_a_measurement_makes_no_sentence_and_every_code_has_one(imports):
    """Codes and numbers are measured and stored; sentences are made of them above."""
    from bayesbl.sentences import SENTENCES

    users = {module for module, targets in imports.items() if "sentences" in targets}
    assert not {module for module in users if module.startswith(("measurement", "results"))}
    used = set()
    for name, path in files().items():
        if name.startswith(("measurement", "fleet", "sampling", "matching")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                # Reason.of_text carries the sentence of a room below.
                if isinstance(node, ast.Call) and ast.unparse(node.func) in ("Reason", "Flaw"):
                    used |= {a.value for a in node.args[:1] if isinstance(a, ast.Constant)}
    assert used
    assert used <= set(SENTENCES)


def test_every_code_that_decides_an_outcome_is_given():
    from bayesbl.measurement.measurement import LIMITING, WITHHOLDING

    given = {
        node.value
        for path in files().values()
        if path.name != "sentences.py"
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant)
    }
    assert given >= LIMITING | WITHHOLDING
