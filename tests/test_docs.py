"""Documentation keeps its promises: references to it resolve, and what it names is there."""

from __future__ import annotations

import os
import re
import runpy
import shlex
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import typer.main
from places import ROOT

from bayesbl.cli import app
from bayesbl.presentation.console import all_bibtex

DESIGN = ROOT / "docs" / "design.md"
CODE_FOLDERS = ("bayesbl", "experiments", "paper_figures", "tests")
SHELL = re.compile(r"^```(?:sh|\{code-cell\}[^\n]*\n%%sh)\n(.*?)^```", re.S | re.M)
DOCS = sorted(f"docs/{page.name}" for page in (ROOT / "docs").glob("*.md"))
OWN = ("README.md", "CHANGELOG.md", "CODE_OF_CONDUCT.md", "CONTRIBUTING.md", "SECURITY.md")
PAGES = (*OWN, *DOCS)
SHELL_CELL = re.compile(r"^```\{code-cell\}[^\n]*\n%%sh\n(.*?)^```", re.S | re.M)
QUICK = {"check", "cite", "init"}
"""Commands of a second or two."""


def headings(text: str) -> set[str]:
    return set(re.findall(r"^#+ (.+?)\s*$", text, re.M))


def anchor(heading: str) -> str:
    """The address of a heading on a page, as GitHub makes it."""
    return re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-")


def has_section(page: Path, section: str) -> bool:
    """Whether a page has a heading with this address; an empty one is the page itself."""
    return not section or section in map(anchor, headings(page.read_text(encoding="utf-8")))


def references() -> Iterator[tuple[str, str | None]]:
    """File and line of every mention of the design in code, and the section that it names."""
    for folder in CODE_FOLDERS:
        for file in sorted((ROOT / folder).rglob("*.py")):
            if file == Path(__file__).resolve():
                continue
            text = file.read_text(encoding="utf-8")
            for mention in re.finditer(r"design\.md", text):
                line = 1 + text.count("\n", 0, mention.start())
                named = re.match(r'design\.md`{0,2},[\s#]+"([^"]+)"', text[mention.start() :])
                whole = text[: mention.start()].endswith("docs/")
                section = re.sub(r"[\s#]+", " ", named[1]) if named and whole else None
                yield f"{file.relative_to(ROOT)}:{line}", section


def test_code_refers_to_sections_of_the_design_that_are_there() -> None:
    found = dict(references())
    sections = headings(DESIGN.read_text(encoding="utf-8"))
    assert found
    assert {place: name for place, name in found.items() if name not in sections} == {}


@pytest.mark.parametrize("page", PAGES)
def test_links_of_a_page_lead_somewhere(page: str) -> None:
    file = ROOT / page
    broken = []
    for target in re.findall(r"\]\(([^)\s]+)\)", file.read_text(encoding="utf-8")):
        path, _, section = target.partition("#")
        there = file.parent / path if path else file
        if "://" not in target and not (there.exists() and has_section(there, section)):
            broken.append(target)
    assert broken == []


@pytest.mark.parametrize("page", PAGES)
def test_files_that_a_page_names_are_there(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    folders, endings = "configs|experiments|paper_figures|tests", "toml|py|csv|json"
    named = set(re.findall(rf"\b((?:{folders})/[\w/]+\.(?:{endings}))", text))
    # What the README has the reader write.
    own = {"configs/my_sweep.toml"}
    assert sorted(name for name in named - own if not (ROOT / name).exists()) == []


def constants_of_the_package() -> dict[str, set[float]]:
    """Values of every constant, by its name and by ``module.NAME``; none where it is computed."""
    constants: dict[str, set[float]] = {}
    for file in (ROOT / "bayesbl").rglob("*.py"):
        text = file.read_text(encoding="utf-8")
        for names, values in re.findall(r"^([A-Z][A-Z_, ]*) = (.+?)(?:  #.*)?$", text, re.M):
            for name, value in zip(names.split(", "), values.split(", "), strict=False):
                number = {float(value)} if re.fullmatch(r"[\d_.e-]+", value) else set()
                for key in (name, f"{file.stem}.{name}"):
                    constants.setdefault(key, set()).update(number)
    return constants


def test_constants_of_the_design_are_those_of_the_code() -> None:
    text = DESIGN.read_text(encoding="utf-8")
    table = text.partition("| constant | value |")[2].partition("\n\n")[0]
    code, compared, wrong = constants_of_the_package(), 0, []
    for row in table.splitlines()[2:]:
        _, names, value, *_ = row.split("|")
        stated = {float(number) for number in re.findall(r"\d+(?:\.\d+)?", value)}
        stated |= {round(0.01 * float(n), 12) for n in re.findall(r"(\d+(?:\.\d+)?) %", value)}
        for name in re.findall(r"`((?:\w+\.)?[A-Z][A-Z_]+)`", names):
            compared += 1
            if name not in code or not code[name] <= stated:
                wrong.append((name, code.get(name), value.strip()))
    assert compared > 10
    assert wrong == []


@pytest.mark.parametrize("maker", ["make_configuration.py", "make_results.py", "make_paper.py"])
def test_a_page_that_is_made_is_as_the_program_is(maker: str) -> None:
    made = runpy.run_path(str(ROOT / "docs" / maker))["pages"]()
    old = [file.name for file, text in made.items() if file.read_text(encoding="utf-8") != text]
    assert old == [], f"run python docs/{maker}"


@pytest.mark.parametrize("page", PAGES)
def test_commands_of_a_page_are_such_as_the_program_takes(page: str) -> None:
    program: Any = typer.main.get_command(app)
    for shell in SHELL.findall((ROOT / page).read_text(encoding="utf-8")):
        for line in re.findall(r"(?:^|&& )(?:\S*/)?bayesbl (.+)", shell.replace("\\\n", ""), re.M):
            name, *given = shlex.split(line, comments=True)
            program.commands[name].make_context(name, given)


class Kernel:
    """What ``docs/kernel_start.py`` asks of IPython."""

    def __init__(self) -> None:
        self.magics: dict[str, Callable[[str, str], None]] = {}

    def register_magic_function(
        self, function: Callable[[str, str], None], kind: str, name: str
    ) -> None:
        self.magics[name] = function


@pytest.mark.parametrize("page", ["docs/first_answer.md", "docs/own_joint.md", "docs/cite.md"])
def test_quick_commands_of_a_page_run_on_the_files_that_the_page_has_made(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kernel = Kernel()
    monkeypatch.setattr(pytest.importorskip("IPython"), "get_ipython", lambda: kernel)
    monkeypatch.chdir(tmp_path)
    beside = str(Path(sys.executable).parent)
    monkeypatch.setenv("PATH", os.pathsep.join([beside, os.environ["PATH"]]))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    runpy.run_path(str(ROOT / "docs" / "kernel_start.py"))
    cells = SHELL_CELL.findall((ROOT / page).read_text(encoding="utf-8"))
    quick = [cell for cell in cells if set(re.findall(r"^bayesbl (\w+)", cell, re.M)) <= QUICK]
    assert quick
    for cell in quick:
        kernel.magics["sh"]("", cell)  # which raises where a command fails


def test_the_bibliography_of_the_paper_is_that_of_the_program() -> None:
    text = (ROOT / "paper" / "paper.bib").read_text(encoding="utf-8")
    assert text.strip() == all_bibtex()
    cited = set(re.findall(r"@(\w+)", (ROOT / "paper" / "paper.md").read_text(encoding="utf-8")))
    assert cited <= set(re.findall(r"^@\w+\{(\w+),", text, re.M))


def test_the_design_describes_every_room() -> None:
    text = DESIGN.read_text(encoding="utf-8")
    table = text.partition("| room | holds |")[2].partition("\n\n")[0]
    described = set(re.findall(r"`(\w+)`", "\n".join(re.findall(r"^\| (.+?) \|", table, re.M))))
    rooms = {
        path.stem
        for path in (ROOT / "bayesbl").iterdir()
        if not path.name.startswith(("_", ".")) and path.suffix in ("", ".py")
    }
    assert described == rooms
