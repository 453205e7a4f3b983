"""Recent simulations, kept for reuse.

Fits of many candidates start at one point, and each would simulate the nominal bench around it.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock

import numpy as np

from bayesbl.recording.types import FloatArray

MOST_BYTES = 32_000_000


class RecentSimulations:
    """Signals by their parameters; the oldest are forgotten. Safe between threads."""

    def __init__(self, most_bytes: int = MOST_BYTES) -> None:
        self._most_bytes = most_bytes
        self._bytes = 0
        self._lock = Lock()
        self._kept: OrderedDict[tuple[Hashable, bytes], FloatArray] = OrderedDict()

    def signals(
        self,
        matrix: FloatArray,
        settings: Hashable,
        simulate: Callable[[FloatArray], FloatArray],
    ) -> FloatArray:
        """Signals of each parameter vector, (m, SLOTS) to (m, c, k).

        Parameters
        ----------
        settings
            Everything else that the signals depend on.
        simulate
            Makes the signals of the rows that are not known.
        """
        keys = [(settings, row.tobytes()) for row in matrix]
        with self._lock:
            known = {i: self._kept[key] for i, key in enumerate(keys) if key in self._kept}
        missing = [i for i in range(len(keys)) if i not in known]
        if missing:
            # What is missing may be made with this cache, which forgets some meanwhile.
            known |= zip(missing, simulate(matrix[missing]), strict=True)
        ordered = [known[i] for i in range(len(keys))]
        with self._lock:
            self._keep(keys, ordered)
        return np.stack(ordered)

    def _keep(self, keys: list[tuple[Hashable, bytes]], ordered: list[FloatArray]) -> None:
        for key, signals in zip(keys, ordered, strict=True):
            if key not in self._kept:
                self._kept[key] = signals.copy()
                self._bytes += _size(key, signals)
            self._kept.move_to_end(key)
        while self._bytes > self._most_bytes and len(self._kept) > 1:
            self._bytes -= _size(*self._kept.popitem(last=False))


def _size(key: tuple[Hashable, bytes], signals: FloatArray) -> int:
    return len(key[1]) + signals.nbytes
