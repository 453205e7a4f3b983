"""The methods of diagnosis, by their names in ``[comparison] method``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from bayesbl.diagnosis.closed_loop import diagnosis as closed_loop
from bayesbl.diagnosis.rigid import free_motion, inverse, speed_loop
from bayesbl.diagnosis.task import Comparison, Task


def _forward(task: Task) -> Comparison:
    rigid = task.bench.drive == "rigid"
    return speed_loop.comparison(task) if rigid else closed_loop.comparison(task)


METHODS: Mapping[str, Callable[[Task], Comparison]] = MappingProxyType(
    {
        "forward": _forward,
        "inverse": inverse.comparison,
        "free_motion": free_motion.comparison,
    }
)
"""Each refuses bench, recordings or unknowns that do not suit it (``UserError``)."""
