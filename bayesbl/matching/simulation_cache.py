"""Recent simulations, kept for reuse.

Fits of many candidates start at one point, and each would simulate the nominal bench around it.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable

import numpy as np

from bayesbl.recording.types import FloatArray

MOST_BYTES = 32_000_000


class RecentSimulations:
    """Signals by their parameters; the oldest are forgotten."""

    def __init__(self, most_bytes: int = MOST_BYTES) -> None:
        self._most_bytes = most_bytes
        self._bytes = 0
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
        missing = [i for i, key in enumerate(keys) if key not in self._kept]
        fresh = dict(zip(missing, simulate(matrix[missing]), strict=True)) if missing else {}
        found = np.stack(
            [fresh[i] if i in fresh else self._kept[keys[i]] for i in range(len(keys))]
        )
        for i, key in enumerate(keys):
            if key in self._kept:
                self._kept.move_to_end(key)
            else:
                self._kept[key] = fresh[i].copy()
                self._bytes += fresh[i].nbytes
        self._forget()
        return found

    def _forget(self) -> None:
        while self._bytes > self._most_bytes and len(self._kept) > 1:
            _, oldest = self._kept.popitem(last=False)
            self._bytes -= oldest.nbytes
