"""Print plain text on the terminal, never wider than it, and show the progress of a run.

Names and messages may come from a stranger's file, so characters that steer a terminal are removed
from everything printed. Texts are printed as :class:`rich.text.Text`, because brackets in names
would be taken for markup. rich is imported only to print, so that ``bayesbl --help`` is fast.
"""

from __future__ import annotations

import io
import re
import sys
import textwrap
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Literal, TextIO

from bayesbl.errors import UserError
from bayesbl.presentation.blocks import Block, Sentence, Table
from bayesbl.presentation.words import glued
from bayesbl.progress import StageProgress

if TYPE_CHECKING:
    from rich.console import Console


_STYLES = {"": "", "heading": "bold", "answer": "bold", "withheld": "bold yellow"}
_STYLES |= {"aside": "dim", "warning": "yellow"}
_BETWEEN = 2  # space between two columns of a table
_NARROWEST_NAME = 12  # width to which the first column of a table may be folded
_INDENT = "  "

_GLUE = "\N{NO-BREAK SPACE}"

STEERING = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
"""Characters that steer a terminal or change the direction of writing."""


def plain(text: str) -> str:
    """The text without :data:`STEERING`."""
    return STEERING.sub("", text)


def say(text: str, *, err: bool = False) -> None:
    """Print a line unchanged on standard output or error."""
    print(plain(text), file=sys.stderr if err else sys.stdout)


def replace_what_cannot_be_printed() -> None:
    """Let standard output and error take every text, whatever their encoding."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def make_console(*, stderr: bool = False, file: TextIO | None = None) -> Console:
    """A console for plain texts, in colour only on a terminal; or into a file."""
    from rich.console import Console, ConsoleOptions, RenderableType
    from rich.segment import Segment

    class PlainConsole(Console):
        def render(
            self, renderable: RenderableType, options: ConsoleOptions | None = None
        ) -> Iterable[Segment]:
            for segment in super().render(renderable, options):
                own = segment.control  # rich's, not a text's
                yield segment if own else segment._replace(text=plain(segment.text))

    return PlainConsole(stderr=stderr, file=file, highlight=False, markup=False, emoji=False)


def error(console: Console, problem: UserError) -> None:
    """Print an error unwrapped, so that paths can be copied and scripts can search it."""
    from rich.text import Text

    text = Text("Error: ", style="bold red")
    console.print(text.append(str(problem), style="not bold default"), soft_wrap=True)
    for note in getattr(problem, "__notes__", ()):
        console.print(Text(note), soft_wrap=True)


def print_blocks(blocks: Iterable[Block], console: Console) -> None:
    """Print headings after an empty line, wrapped sentences, and tables between empty lines."""
    is_below_table = False
    for block in blocks:
        if is_below_table or isinstance(block, Table) or block.tone == "heading":
            console.print()
        is_below_table = isinstance(block, Table)
        if isinstance(block, Table):
            print_table(block, console)
        else:
            _print_text(block, console)
    if is_below_table:
        console.print()


def print_table(table: Table, console: Console) -> None:
    """Print a row on one line if the terminal is wide enough, else as a block."""
    columns = list(zip(table.titles, *table.rows, strict=True))
    name, *others = (max(map(len, "\n".join(column).splitlines())) for column in columns)
    if min(name, _NARROWEST_NAME) + sum(others) + _BETWEEN * len(others) <= console.width:
        _print_lines(table, console)
    else:
        _print_row_by_row(table, console)


def filled(pairs: Sequence[str], width: int) -> list[str]:
    """Pairs with commas, wrapped only between pairs."""
    whole = ", ".join(pair.replace(" ", _GLUE) for pair in pairs)
    lines = textwrap.wrap(whole, width, break_on_hyphens=False, break_long_words=False)
    return [line.replace(_GLUE, " ") for line in lines]


def wrapped(sentence: str, width: int) -> str:
    """A sentence wrapped to ``width``, but not between a number and its sign or unit."""
    lines = textwrap.wrap(glued(sentence), width, break_on_hyphens=False)
    return "\n".join(lines).replace(_GLUE, " ")


def _print_text(sentence: Sentence, console: Console) -> None:
    from rich.text import Text

    label = f"{sentence.label}: " if sentence.label else ""
    text = Text(wrapped(label + sentence.text, console.width), style=_STYLES[sentence.tone])
    if label:
        text.stylize("bold", 0, len(label) - 1)
    console.print(text, soft_wrap=True)


def _print_lines(table: Table, console: Console) -> None:
    """Only the first column may fold."""
    from rich import box
    from rich.table import Table as Lines
    from rich.text import Text

    lines = Lines(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
    for i, (title, numeric) in enumerate(zip(table.titles, table.numeric, strict=True)):
        side: Literal["left", "right"] = "right" if numeric else "left"
        lines.add_column(Text(title), justify=side, overflow="fold", no_wrap=i > 0)
    for row in table.rows:
        lines.add_row(*map(Text, row))
    console.print(lines)


def _print_row_by_row(table: Table, console: Console) -> None:
    from rich.text import Text

    titles = [title.replace("\n", " ") for title in table.titles]
    # A name speaks for itself, a number does not.
    first = f"{titles[0]} " if table.numeric[0] else ""
    for row in table.rows:
        console.print(Text(first + row[0], style="bold"), soft_wrap=True)
        pairs = [f"{title} {cell}" for title, cell in zip(titles[1:], row[1:], strict=True) if cell]
        for line in filled(pairs, console.width - len(_INDENT)):
            console.print(Text(_INDENT + line), soft_wrap=True)


SILENT_S = 2.0  # longest initial silence in a log
SILENT_SHARE = 0.1  # part of the elapsed time to which a silence grows: a hundred lines a day


@contextmanager
def progress(console: Console) -> Iterator[StageProgress]:
    """Show progress on ``console`` (standard error) until the block ends.

    Yields the function to call with a stage, its steps done and their number. On a terminal it
    shows a bar. In a log, a thread repeats stage and elapsed time before a silence gets long,
    because imports, compilation and single long steps report nothing themselves.
    """
    # Rich takes a pipe for a terminal where FORCE_COLOR asks for colours, as notebooks do.
    if console.file.isatty():
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
        from rich.progress import TimeElapsedColumn as Elapsed

        name = TextColumn("{task.description}", markup=False)
        columns = (name, BarColumn(bar_width=24), MofNCompleteColumn(), Elapsed())
        with Progress(*columns, console=console, transient=True) as bars:
            task = bars.add_task("Starting", total=None)

            def show(stage: str, done: int, count: int, /) -> None:
                bars.update(task, description=stage, completed=done, total=count)

            yield show
        return
    begin_s, ended, state = time.monotonic(), threading.Event(), ["Starting"]

    def tell(stage: str, done: int, count: int, /) -> None:
        state[0] = f"{stage}: {done} of {count}"

    def speak() -> None:
        lasting_s = 0.0
        while not ended.wait(max(SILENT_S, SILENT_SHARE * lasting_s)):
            lasting_s = time.monotonic() - begin_s
            line = f"{state[0]}, after {lasting_s:.0f} s"
            console.print(line, markup=False, highlight=False, soft_wrap=True)

    thread = threading.Thread(target=speak, name="progress", daemon=True)
    thread.start()
    try:
        yield tell
    finally:
        ended.set()
        thread.join()
