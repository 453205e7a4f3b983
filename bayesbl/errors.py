"""Errors that a user can fix: each says where, what was found and what was expected."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TypeVar

E = TypeVar("E", bound="UserError")


class UserError(Exception):
    """A mistake in usage, configuration or input; ends the command with exit status 2.

    ``problem`` is a sentence without the place. ``where`` is the line, column or field in the
    ``file``: ``"line 14"``, ``"[run] seed"``. ``found`` and ``expected`` say what was there, and
    what should have been. Programs use ``code``.
    """

    code = "refused"

    def __init__(
        self,
        problem: str,
        *,
        file: str | Path | None = None,
        where: str | None = None,
        found: object | None = None,
        expected: str | None = None,
    ) -> None:
        self.problem = problem
        self.file = None if file is None else str(file)
        self.where = where
        self.found = None if found is None else str(found)
        self.expected = expected
        super().__init__(self._message())

    def name_file(self, file: str | Path) -> None:
        """State the file if none is stated yet."""
        if self.file is None:
            self.file = str(file)
            self.args = (self._message(),)

    def at(self, kind: type[E], where: str = "", file: str | Path | None = None) -> E:
        """The same error of this kind, with ``where`` in front of its place, in this file."""
        place = f"{where}{self.where or ''}".rstrip(" ,") or None
        file = self.file if file is None else file
        return kind(self.problem, file=file, where=place, found=self.found, expected=self.expected)

    def __reduce__(self) -> tuple[object, ...]:
        # Exceptions that cross process boundaries are rebuilt from args and would lose keywords.
        details = {key: getattr(self, key) for key in ("file", "where", "found", "expected")}
        return partial(type(self), self.problem, **details), ()

    def _message(self) -> str:
        place = ", ".join(part for part in (self.file, self.where) if part)
        text = f"{place}: {self.problem}" if place else self.problem
        if self.found is not None:
            text += f" Found: {_ended(self.found)}"
        if self.expected is not None:
            text += f" Expected: {_ended(self.expected)}"
        return text


@contextmanager
def naming(file: str | Path) -> Iterator[None]:
    """Let errors of this block that name no file name this one."""
    try:
        yield
    except UserError as error:
        error.name_file(file)
        raise


def shortened(text: str, length: int = 40) -> str:
    """The text, cut to a length that fits into a message."""
    return text if len(text) <= length else text[: length - 1] + "…"


def _ended(text: str) -> str:
    return text if text.endswith((".", "?", "!")) else f"{text}."


class ConfigError(UserError):
    """A configuration or command-line option that cannot be run as written."""


class RecordingError(UserError):
    """A recording that cannot be read, or that a task cannot use."""


class UnavailableError(RecordingError):
    """A recording that cannot be read here and now, although its content may be sound: a library is
    missing, the file may not be read, or a limit of this machine is exceeded."""


class NeedsBench(RecordingError):
    """A recording of a motion, whose gap can only be measured with a bench."""

    code = "needs_bench"


class NoFlankChange(RecordingError):
    """The load stays on one flank, or may: no gap is visible. ``MOTION`` is what would show it."""

    code = "no_flank_change"
    MOTION = (
        "a recording of strokes to and fro, which brake and accelerate the load both ways "
        "(`bayesbl plan --bench FILE` ranks motions)"
    )


class BenchError(UserError):
    """A virtual bench whose parameters make no physical sense, or whose simulation fails."""


class SimulationError(BenchError):
    """Values with which a bench cannot be simulated; a search turns back from them."""


class CurveError(UserError):
    """A gap curve that cannot be used with this fit."""


class ResultError(UserError):
    """A stored result that is missing, damaged, unfinished, or in the way."""


class WorkerError(UserError):
    """A worker process that died, most likely for lack of memory."""


class ClusterError(UserError):
    """A cluster that cannot be reached, or whose workers cannot run a study."""


class BrokerError(UserError):
    """A message broker that cannot be reached, or refuses us."""
