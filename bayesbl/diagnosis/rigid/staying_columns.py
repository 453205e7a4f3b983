"""Linear least squares over pieces, and along a scan of which most columns stay as they are."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from bayesbl.recording.types import FloatArray

DEPENDENT = 1e-8
"""Share of its own length that a column must have apart from the others, to be fitted."""

ROUNDED = 1e-12
"""The same squared, where only products of columns are known: below it they are rounding."""


def least_squares(matrix: FloatArray, target: FloatArray) -> FloatArray:
    """x of the least ‖target − matrix x‖, shape (p,), with columns of any unit, (n, p)."""
    scale = _lengths(matrix)
    return np.asarray(np.linalg.lstsq(matrix / scale, target, rcond=DEPENDENT)[0] / scale)


class Staying:
    """Columns F that stay while others, Z, are scanned.

    min ‖r − F x − Z z‖² = ‖r‖² − ‖Qᵀr‖² − hᵀG⁺h,   h = Zᵀr − BᵀQᵀr,   G = ZᵀZ − BᵀB,   B = QᵀZ

    with Q an orthonormal basis of F. A piece where a column is zero throughout leaves it out.
    """

    def __init__(self, tables: Sequence[Mapping[str, FloatArray]]) -> None:
        """Columns of every piece by name, each of shape (k,)."""
        names = list(dict.fromkeys(name for table in tables for name in table))
        held = [stacked(table, names) if table else None for table in tables]
        # Where a piece has none of them its rows are zero, and so are those of the basis.
        self._parts: list[FloatArray | None] = [None] * len(tables)
        self._size = 0
        if not names:
            return
        rows = [part for part in held if part is not None]
        matrix = np.vstack(rows)
        basis, triangle = np.linalg.qr(matrix / _lengths(matrix))
        turned, sizes, _ = np.linalg.svd(triangle)
        basis = basis @ turned[:, sizes > DEPENDENT * sizes.max(initial=0.0)]
        self._size = basis.shape[1]
        parts = iter(np.split(basis, np.cumsum([len(part) for part in rows])[:-1]))
        self._parts = [None if part is None else next(parts) for part in held]

    def along(self, rests: Sequence[FloatArray]) -> FloatArray:
        """Qᵀr of every piece's r, shape (q,)."""
        found = np.zeros(self._size)
        for part, rest in zip(self._parts, rests, strict=True):
            if part is not None:
                found += part.T @ rest
        return found

    def explained(
        self,
        tables: Sequence[Mapping[str, FloatArray]],
        rests: Sequence[FloatArray],
        along: FloatArray,
    ) -> float:
        """ΔΣr² that the columns Z of ``tables`` explain beyond F."""
        names = list(dict.fromkeys(name for table in tables for name in table))
        size = len(names)
        shared = np.zeros((self._size, size))
        products, score = np.zeros((size, size)), np.zeros(size)
        for part, table, rest in zip(self._parts, tables, rests, strict=True):
            here = [k for k, name in enumerate(names) if name in table]
            if here:
                columns = np.column_stack([table[names[k]] for k in here])
                products[np.ix_(here, here)] += columns.T @ columns
                score[here] += columns.T @ rest
                if part is not None:
                    shared[:, here] += part.T @ columns
        scale = np.sqrt(np.diag(products))
        scale = np.where(scale > _LEAST, scale, np.inf)
        left = (score - shared.T @ along) / scale
        apart = (products - shared.T @ shared) / np.outer(scale, scale)
        sizes, turned = np.linalg.eigh(apart)
        seen = sizes > ROUNDED
        return float(np.sum((turned[:, seen].T @ left) ** 2 / sizes[seen]))


_LEAST = math.sqrt(np.finfo(float).tiny)
"""A column whose squares underflow says nothing of its size."""


def _lengths(matrix: FloatArray) -> FloatArray:
    scale = np.sqrt((matrix**2).sum(axis=0))
    return np.where(scale > _LEAST, scale, np.inf)


def stacked(table: Mapping[str, FloatArray], names: Sequence[str]) -> FloatArray:
    """Columns of a piece by these names, shape (k, p); 0 where it has none of a name."""
    nothing = np.zeros_like(next(iter(table.values())))
    return np.column_stack([table.get(name, nothing) for name in names])
