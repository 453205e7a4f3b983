"""How much commands print and draw, by options that stand before or after the command."""

from __future__ import annotations

from collections.abc import Sequence
from contextvars import ContextVar
from typing import Literal

Volume = Literal["quiet", "normal", "verbose"]

VOLUME: ContextVar[Volume] = ContextVar("volume", default="normal")
"""Of the command that runs."""

FIGURES: ContextVar[tuple[str, ...]] = ContextVar("figures", default=("png",))
"""Formats in which a run draws its figures."""

_OPTIONS = ("--quiet", "--verbose", "--no-figures", "--pdf")


def brought_forward(arguments: Sequence[str]) -> list[str]:
    """The same arguments with these options before the command, where they are read."""
    end = arguments.index("--") if "--" in arguments else len(arguments)
    ours = [text for text in arguments[:end] if text in _OPTIONS]
    others = [text for text in arguments[:end] if text not in _OPTIONS]
    return [*ours, *others, *arguments[end:]]
