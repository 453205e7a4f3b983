"""What each figure of a result shows, by the beginning of its file name, in reading order."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType

CAPTIONS: Mapping[str, str] = MappingProxyType(
    {
        "signal": "The measured motor speed with the fitted ringing.",
        "gap": "Each gap on the curve it was read from, and the distribution of the change.",
        "change": "The distribution of the change of the gap.",
        "wear": "The gap against the date, and when it reaches its limit.",
        "curve": "Gap against amplitude of the ringing: the sweep and the curve through it.",
        "disturbance": "The ringing as the gap grows.",
        "degrees": "How well polynomials of other degrees describe the sweep.",
        "bench_draws": "The curve over benches within their tolerances.",
        "diagnosis": "Measured signal, bench before and after naming, and what is left.",
        "named": "The posterior of the gap and of what was named.",
        "misfit": "What repeats every rotation and the model does not describe.",
        "noise": "What does not repeat from one rotation to the next, and its noise model.",
        "convergence": "How the search found its optimum.",
        "corner": "The posterior of every free parameter, pair by pair.",
        "trace": "The sampler's ensembles, step by step.",
    }
)


FOR_SPECIALISTS = frozenset({"noise", "convergence", "corner", "trace"})
"""Figures of how an answer came about, which nobody needs who only acts on it."""


def is_for_specialists(name: str) -> bool:
    """Whether a figure file's stem is one of those."""
    return _prefix(name) in FOR_SPECIALISTS


def _prefix(name: str) -> str | None:
    return next((key for key in CAPTIONS if name == key or name.startswith(f"{key}_")), None)


def caption(name: str) -> str:
    """The caption of a figure file's stem; of an unknown figure its name in words."""
    key = _prefix(name)
    if key is None:
        return name.replace("_", " ").capitalize() + "."
    rest = name.removeprefix(key).strip("_").replace("_", " ")
    return f"{rest}: {CAPTIONS[key][0].lower()}{CAPTIONS[key][1:]}" if rest else CAPTIONS[key]


def reading_order(names: Iterable[str], snapshots: Sequence[str]) -> list[str]:
    """Stems of figure files as :data:`CAPTIONS` lists them, then snapshot by snapshot."""
    kinds = list(CAPTIONS)
    stems = [snapshot.replace(" ", "_") for snapshot in snapshots]

    def place(name: str) -> tuple[int, int, str]:
        key = _prefix(name)
        if key is None:
            return len(kinds), 0, name
        rest = name.removeprefix(key).removeprefix("_")
        return kinds.index(key), stems.index(rest) if rest in stems else len(stems), name

    return sorted(names, key=place)
