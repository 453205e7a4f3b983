"""Errors of a data sheet that are made often, guessed from the factor by which a value is wrong."""

from __future__ import annotations

import math

from bayesbl.units import RPM_PER_RAD_PER_S

DEGREES_PER_RAD = math.degrees(1.0)


def guess_of(believed: float, tolerance: float, found: float, gear_ratio: float) -> str:
    """What the value may have been mistaken for, behind a space; empty if nothing is known.

    An error is one that explains the value if it is within its tolerance without it: all such are
    told, the nearest first.
    """
    errors = (
        (10.0, "a decimal place"),
        (RPM_PER_RAD_PER_S, "rpm taken for rad/s"),
        (DEGREES_PER_RAD, "degrees taken for radians"),
        (60.0 * DEGREES_PER_RAD, "arcmin taken for radians"),
        (100.0, "cm taken for m, or per cent"),
        (1e3, "ms taken for s, g for kg, or mm for m"),
        (1e4, "kg cm² taken for kg m²"),
        (gear_ratio, "the gear ratio: one is seen at the motor, the other at the load"),
        (gear_ratio**2, "the gear ratio squared: one is seen at the motor, the other at the load"),
    )
    factor = found / believed
    share = tolerance / believed
    near: list[tuple[float, str]] = []
    for size, words in errors:
        left = factor / size if factor > 1.0 else factor * size
        if size > 1.0 and abs(left - 1.0) <= share:
            near.append((abs(math.log(left)), words))
    if not near:
        return ""
    rounded = float(f"{max(factor, 1.0 / factor):.3g}")
    how = f"{rounded:g} times" if factor > 1.0 else f"1/{rounded:g} of"
    told = " or ".join(words for _, words in sorted(near, key=lambda error: error[0]))
    return f" It is about {how} the data sheet's, as by {told}."
