"""What the bench's own uncertain parameters do to the curve.

The bench is swept at some draws of its parameters. At each gap, ln A, ln ω and ln τ are then
described as smooth functions of the parameters (each draw regressed at its own gap: A on the
parameters, never pooled points of δ on A), which gives as many further draws as inference needs.
Its residuals are added back from the swept draws themselves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesbl.recording.types import FloatArray

VIRTUAL_DRAWS = 3000


@dataclass(frozen=True, slots=True)
class SweptDraws:
    """Sweeps of benches drawn within the tolerances.

    Attributes
    ----------
    names
        The p parameters that have a tolerance.
    shifts
        Each parameter's departure in units of its tolerance, in [−1, 1], shape (b, p); beyond that
        where it was identified.
    departures
        Departure of (ln A, ln ω, ln τ) from the nominal sweep at each gap, shape (b, g, 3).
    root
        Of the covariance of the shifts where they are normal, shape (p, p); ``None``: uniform.
    """

    names: tuple[str, ...]
    shifts: FloatArray
    departures: FloatArray
    root: FloatArray | None = None


def virtual_departures(
    swept: SweptDraws, generator: np.random.Generator, count: int = VIRTUAL_DRAWS
) -> FloatArray:
    """Departures (ln A, ln ω, ln τ) of ``count`` benches drawn within the tolerances.

    Linear in the parameters, with their squares where the swept draws are three times as many as
    the terms; the swept draws alone, with repetition, if they are too few for either.

    Returns
    -------
    Shape (count, g, 3).
    """
    draws, parameters = swept.shifts.shape
    if draws < 2 * (1 + parameters):
        return np.asarray(swept.departures[generator.integers(draws, size=count)])
    squares = draws >= 3 * (1 + 2 * parameters)
    design = _terms(swept.shifts, squares)
    flat = swept.departures.reshape(draws, -1)
    solution = np.linalg.lstsq(design, flat, rcond=None)[0]
    freedom = max(draws - design.shape[1], 1)
    left = (flat - design @ solution) * np.sqrt(draws / freedom)
    if swept.root is None:
        virtual = generator.uniform(-1.0, 1.0, size=(count, parameters))
    else:
        virtual = generator.standard_normal((count, parameters)) @ swept.root.T
    described = _terms(virtual, squares) @ solution + left[generator.integers(draws, size=count)]
    return np.asarray(described.reshape(count, *swept.departures.shape[1:]))


def _terms(shifts: FloatArray, squares: bool) -> FloatArray:
    columns = [np.ones((len(shifts), 1)), shifts]
    if squares:
        columns.append(shifts**2)
    return np.concatenate(columns, axis=1)
