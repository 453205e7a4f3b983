"""A cell of text: the number that it holds, the unit behind it, and how its decimals are marked."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from bayesbl.errors import RecordingError, shortened
from bayesbl.recording.timestamps import is_date
from bayesbl.units import is_unit, spelled

MISSING = frozenset(
    "|nan|-nan|nan(ind)|-nan(ind)|1.#qnan|-1.#ind|null|none|nil|n/a|na|#n/a|#na|#value!|#div/0!"  # noqa: SIM905
    "|#num!|-|--|---|?|missing".split("|")
)
_PLAIN = {mark: re.compile(rf"[+-]?(\d+[{mark}]?\d*|[{mark}]\d+)([eE][+-]?\d+)?") for mark in ".,"}
_GROUPED = {
    mark: re.compile(rf"[+-]?[1-9]\d{{0,2}}(?:[{other}'’\u00a0\u202f ]\d{{3}})+(?:[{mark}]\d*)?")
    for mark, other in ((".", ","), (",", "."))
}
_WITH_UNIT = re.compile(r"([+\-−]?\d[^\sA-Za-z]*(?:[eE][+-]?\d+)?)\s?([^\d\s.,:+\-/].*)")
"""As exports write durations and formatted values: ``0.001 sec``, ``1500.2 rpm``."""


def number_in(cell: str, mark: str) -> float | None:
    """The number that a cell holds, NaN for a missing one; ``None`` if it is text."""
    text = cell.replace("−", "-")
    if mark == "," and "," in text:
        if _PLAIN[","].fullmatch(text):
            return float(text.replace(",", "."))
    elif mark == "." or "." not in text:
        try:
            if text.isascii() and "_" not in text:  # float() reads "1_000"; no instrument does
                return float(text)
        except ValueError:
            pass
    if text.lower() in MISSING:
        return float("nan")
    if _GROUPED[mark].fullmatch(text):
        plain = re.sub(r"[^\d+.,-]", "", text).replace("." if mark == "," else ",", "")
        return float(plain.replace(",", "."))
    return None


def parted(cell: str) -> tuple[str, str]:
    """A cell's number and the unit behind it; the cell where there is none that is known."""
    held = _WITH_UNIT.fullmatch(cell)
    return (held[1], held[2]) if held and is_unit(spelled(held[2])) else (cell, "")


def is_number(cell: str) -> bool:
    """Whether it may be a number with either mark, bare or before its unit; never if missing."""
    return is_bare_number(parted(cell)[0])


def is_bare_number(cell: str) -> bool:
    return any(
        (value := number_in(cell, mark)) is not None and (value == value or cell.lower() == "nan")
        for mark in ".,"
    )


def is_value(cell: str) -> bool:
    return is_date(cell) or is_number(cell)


def decimal_mark(file: Path, cells: Sequence[str]) -> str:
    """Whether numbers have a decimal comma or a decimal point, by all of them together."""
    cells = [number for cell in cells if is_number(number := parted(cell)[0])]
    if not any("," in cell for cell in cells):
        return "."
    fits = {mark: sum(number_in(cell, mark) is not None for cell in cells) for mark in ".,"}
    if fits["."] == fits[","]:
        example = next(cell for cell in cells if "," in cell)
        raise RecordingError(
            "A comma may be a decimal comma here, or part thousands.",
            file=file,
            found=repr(shortened(example)),
            expected=f"{example.replace(',', '.')} or {example.replace(',', '')}: numbers without "
            "marks between thousands",
        )
    return "," if fits[","] > fits["."] else "."
