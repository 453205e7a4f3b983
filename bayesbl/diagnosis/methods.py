"""The methods of diagnosis behind one protocol, imported when they are asked for.

To add one: a module with a ``METHOD`` that follows :class:`Method`, an entry in :data:`METHODS`,
and its name in ``[comparison] method``.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from bayesbl.diagnosis.diagnosis import Diagnosis
    from bayesbl.diagnosis.task import Task
    from bayesbl.progress import StageProgress


class Method(Protocol):
    """A way to put a bench beside recordings and to find what it lacks."""

    @property
    def name(self) -> str:
        """As ``[comparison] method`` gives it."""

    def describe(self, task: Task) -> str:
        """What would be compared, without comparing it; a task that does not suit is refused."""

    def diagnose(self, task: Task, progress: StageProgress | None = None) -> Diagnosis:
        """The answer.

        Raises
        ------
        UserError
            If bench, recordings or unknowns do not suit the method.
        """


METHODS: Mapping[str, str] = MappingProxyType(
    {
        "forward": "bayesbl.diagnosis.closed_loop.method",
        "inverse": "bayesbl.diagnosis.rigid.method",
        "free_motion": "bayesbl.diagnosis.free_motion",
    }
)
"""Name to the module that holds the method."""


def method_named(name: str) -> Method:
    """The method of this name."""
    found: Method = import_module(METHODS[name]).METHOD
    return found
