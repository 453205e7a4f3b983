"""Gap curves in ``result.nc``: the band that every result shows, and the whole curve of a sweep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

import numpy as np
import xarray as xr

from bayesbl.curve.gap_curve import GapCurve, Ringing
from bayesbl.errors import CurveError
from bayesbl.recording.types import FloatArray
from bayesbl.results.stacking import stack_snapshots
from bayesbl.results.store import read_tree, texts
from bayesbl.results.variables import (
    Group,
    Variable,
    arrays,
    attributes,
    dataset,
    require_declared,
    table,
)

AMPLITUDES = 200
"""At which a curve is stored for figures."""

SOURCE_PREFIX = "source_"
"""Of the variables of a stored gap curve that hold draws of one source of its uncertainty."""

_COEFFICIENTS = table("coefficients (power) | rad / rpm^k | coefficient of A^k in the gap curve")

CURVE = Group(
    "curve",
    (
        *table("""
            delta_rad (amplitude) | rad | backlash gap, nominal
            low_rad (amplitude) | rad | lower bound of the curve's band
            high_rad (amplitude) | rad | upper bound of the curve's band
        """),
        *_COEFFICIENTS,
    ),
    table("amplitude (amplitude) | rpm | amplitude of the impact ringing"),
    optional=True,
)


def _source(name: str) -> Variable | None:
    if not name.startswith(SOURCE_PREFIX):
        return None
    source = name.removeprefix(SOURCE_PREFIX)
    meaning = f"departures of ln δ from the curve, source {source}"
    return Variable(name, (f"draw_{source}", "knot"), "1", meaning)


GAP_CURVE = Group(
    "gap_curve",
    (
        *_COEFFICIENTS,
        *table("""
            knots_rpm (knot) | rpm | amplitude of the impact ringing
            correction (knot) | 1 | departure of ln δ from the polynomial's
            start_angle_sd_rpm (knot) | rpm | scatter of the amplitude with the start angle
            log_frequency? (knot) | 1 | ln of ω in rad/s
            log_decay? (knot) | 1 | ln of τ in 1/s
            frequency_draws? (draw_bench, knot) | 1 | departures of ln ω for the bench draws
            decay_draws? (draw_bench, knot) | 1 | departures of ln τ for the bench draws
            scatter? (knot, row, column) | mixed | covariance of (A, ln ω, ln τ) over start angles
        """),
    ),
    named=_source,
)


def curve_group(
    curves: Mapping[str, GapCurve], level: float, seed: np.random.SeedSequence
) -> xr.Dataset:
    """The gap curve over its range with the band of its draws.

    Parameters
    ----------
    curves
        By snapshot. Where they differ they are stacked over the range of all.
    """
    first = next(iter(curves.values()))
    if all(curve is first for curve in curves.values()):
        return one_curve_group(first, level, seed)
    ranges = np.array([curve.amplitude_range_rpm for curve in curves.values()])
    amplitude = np.geomspace(ranges.min(), ranges.max(), AMPLITUDES)
    parts = {n: {CURVE.name: _curve(c, amplitude, level, seed)} for n, c in curves.items()}
    return stack_snapshots(parts)[CURVE.name]


def one_curve_group(curve: GapCurve, level: float, seed: np.random.SeedSequence) -> xr.Dataset:
    """The gap curve over its range with the band of its draws."""
    amplitude = np.geomspace(*curve.amplitude_range_rpm, AMPLITUDES)
    return _curve(curve, amplitude, level, seed)


def _curve(
    curve: GapCurve, amplitude: FloatArray, level: float, seed: np.random.SeedSequence
) -> xr.Dataset:
    """A group :data:`CURVE` at these amplitudes."""
    count = 1000
    draws = curve.draw(count, np.random.default_rng(seed))
    table = np.stack([draws.gap(np.full(count, a)) for a in amplitude])
    edges = np.quantile(table, [0.5 - 0.5 * level, 0.5 + 0.5 * level], axis=1)
    result = dataset(
        CURVE,
        {
            "delta_rad": curve.gap(amplitude),
            "low_rad": edges[0],
            "high_rad": edges[1],
            "coefficients": curve.coefficients,
        },
        {"amplitude": amplitude},
    )
    result.attrs = {"name": curve.name, "warnings": list(curve.warnings), "level": level}
    return result


def curve_to_dataset(curve: GapCurve) -> xr.Dataset:
    """The curve as a dataset; :func:`curve_from_dataset` gives it back."""
    sources = {f"{SOURCE_PREFIX}{name}": draws for name, draws in curve.sources.items()}
    ringing = attributes(GAP_CURVE, curve.ringing)
    result = dataset(GAP_CURVE, {**attributes(GAP_CURVE, curve), **sources, **ringing})
    result.attrs = {
        "name": curve.name,
        "fingerprint": curve.fingerprint or "",
        "warnings": list(curve.warnings),
        "reference_speed_rpm": curve.reference_speed_rpm or 0.0,
    }
    return result


def curve_from_dataset(stored: xr.Dataset, name: str) -> GapCurve:
    """The curve that :func:`curve_to_dataset` stored, under a new name.

    Raises
    ------
    ResultError
        If anything is missing.
    """
    found = arrays(GAP_CURVE, stored)
    own = {f.name: found[f.name] for f in fields(GapCurve) if f.name in found}
    return GapCurve(
        name=name,
        sources={
            key.removeprefix(SOURCE_PREFIX): draws
            for key, draws in found.items()
            if key.startswith(SOURCE_PREFIX)
        },
        fingerprint=stored.attrs.get("fingerprint") or None,
        ringing=Ringing(**{f.name: found[f.name] for f in fields(Ringing)})
        if "log_frequency" in found
        else None,
        warnings=tuple(texts(stored.attrs.get("warnings"))),
        reference_speed_rpm=float(stored.attrs.get("reference_speed_rpm", 0.0)) or None,
        **own,
    )


def read_curve(path: str | Path) -> GapCurve:
    """The gap curve of a sweep's result.

    Raises
    ------
    ResultError
        If the file is missing, damaged or unfinished.
    CurveError
        If the result holds no curve.
    """
    tree = read_tree(path)
    if GAP_CURVE.name not in tree.children:
        raise CurveError(
            "This result holds no gap curve.",
            file=path,
            found=f'a result of kind "{tree.attrs.get("kind")}"',
            expected="the result.nc of a sweep",
        )
    require_declared(tree, [GAP_CURVE], path)
    return curve_from_dataset(tree[GAP_CURVE.name].to_dataset(), str(path))
