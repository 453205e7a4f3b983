"""Gap curves in ``result.nc``: the band that every result shows, and the whole curve of a sweep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from types import MappingProxyType

import numpy as np
import xarray as xr
from numpy.polynomial import polynomial
from numpy.typing import NDArray

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

NOTHING: Mapping[str, object] = MappingProxyType({})

AMPLITUDES = 200
"""At which a curve is stored for figures."""

SOURCE_PREFIX = "source_"
"""Of the variables of a stored gap curve that hold draws of one source of its uncertainty."""

ROW_PREFIX = "row_"
"""Of the variables that tell which of these draws belongs to a draw of δ."""

BY_COEFFICIENTS = ("regression", "rounding")
"""Sources that are an uncertainty of the coefficients."""

_COEFFICIENTS = table("coefficients (power) | rad / rpm^k | coefficient of A^k in the gap curve")


def _source(name: str) -> Variable | None:
    if name.startswith(SOURCE_PREFIX):
        source = name.removeprefix(SOURCE_PREFIX)
        meaning = f"departures of ln δ from the curve, source {source}"
        return Variable(name, (f"draw_{source}", "knot"), "1", meaning)
    if name.startswith(ROW_PREFIX):
        source = name.removeprefix(ROW_PREFIX)
        meaning = f"which draw of source {source} each draw of δ went through"
        return Variable(name, ("chain", "draw"), "1", meaning)
    return None


CURVE = Group(
    "curve",
    (
        *table("""
            delta_rad (amplitude) | rad | backlash gap, nominal
            low_rad (amplitude) | rad | lower bound of the curve's band
            high_rad (amplitude) | rad | upper bound of the curve's band
            covariance? (power, power_) | (rad / rpm^k)^2 | covariance of the coefficients
            coefficient_draws? (coefficient_draw, power) | rad / rpm^k
                | draws of the coefficients; the curve's draws are those of its sources
            knots_rpm? (knot) | rpm | amplitude of the impact ringing
            correction? (knot) | 1 | departure of ln δ from the polynomial's
            start_angle_sd_rpm? (knot) | rpm | scatter of the amplitude with the start angle
        """),
        *_COEFFICIENTS,
    ),
    table("amplitude (amplitude) | rpm | amplitude of the impact ringing"),
    named=_source,
    optional=True,
)
"""A curve, and how the draws of δ went through it.

δ = Σ coefficients·A^k · exp(correction + Σ source), at A = ``curve_amplitude_rpm`` of the
posterior, correction and sources linear in ln A between the knots, of each source the row that
``row_…`` names for the draw.
"""


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
    curves: Mapping[str, GapCurve],
    rows: Mapping[str, Mapping[str, NDArray[np.int64]]],
    level: float,
    seed: np.random.SeedSequence,
) -> xr.Dataset:
    """Group :data:`CURVE` of a measurement.

    Parameters
    ----------
    curves
        By recording. Where they differ they are stacked over the range of all.
    rows
        By recording and source, which draw of the curve each draw of δ went through.
    """
    first = next(iter(curves.values()))
    if all(curve is first for curve in curves.values()):
        amplitude = np.geomspace(*first.amplitude_range_rpm, AMPLITUDES)
        return _with_draws(first, next(iter(rows.values())), amplitude, level, seed)
    ranges = np.array([curve.amplitude_range_rpm for curve in curves.values()])
    amplitude = np.geomspace(ranges.min(), ranges.max(), AMPLITUDES)
    parts = {
        name: {CURVE.name: _with_draws(curve, rows[name], amplitude, level, seed)}
        for name, curve in curves.items()
    }
    return stack_snapshots(parts)[CURVE.name]


def one_curve_group(curve: GapCurve, level: float, seed: np.random.SeedSequence) -> xr.Dataset:
    """The gap curve over its range with the band of its draws."""
    return _curve(curve, np.geomspace(*curve.amplitude_range_rpm, AMPLITUDES), level, seed)


def _with_draws(
    curve: GapCurve,
    rows: Mapping[str, NDArray[np.int64]],
    amplitude: FloatArray,
    level: float,
    seed: np.random.SeedSequence,
) -> xr.Dataset:
    drawn = coefficient_draws(curve)
    values: dict[str, object] = attributes(CURVE, curve)
    if drawn is not None:
        values |= {"coefficient_draws": drawn, "covariance": np.cov(drawn, rowvar=False)}
    # As figures and checks need them: a sweep keeps all digits.
    sources = {f"{SOURCE_PREFIX}{n}": d.astype(np.float32) for n, d in curve.sources.items()}
    which = {f"{ROW_PREFIX}{name}": picked for name, picked in rows.items()}
    return _curve(curve, amplitude, level, seed, {**values, **sources, **which})


def coefficient_draws(curve: GapCurve) -> FloatArray | None:
    """Coefficients of each curve that their uncertainty allows, shape (m, degree + 1).

    By relative least squares at the knots; ``None`` where no source is of the coefficients.
    """
    departures = [curve.sources[name] for name in BY_COEFFICIENTS if name in curve.sources]
    if not departures:
        return None
    nominal = polynomial.polyval(curve.knots_rpm, curve.coefficients)
    powers = curve.knots_rpm[:, None] ** np.arange(curve.coefficients.size)
    inverse = np.linalg.pinv(powers / nominal[:, None], rcond=1e-15)
    shares = np.expm1(np.sum(departures, axis=0))
    return np.asarray(curve.coefficients + shares @ inverse.T)


def _curve(
    curve: GapCurve,
    amplitude: FloatArray,
    level: float,
    seed: np.random.SeedSequence,
    beside: Mapping[str, object] = NOTHING,
) -> xr.Dataset:
    """A group :data:`CURVE` at these amplitudes."""
    count = 1000
    draws = curve.draw(count, np.random.default_rng(seed))
    table = np.stack([draws.gap(np.full(count, a)) for a in amplitude])
    edges = np.quantile(table, [0.5 - 0.5 * level, 0.5 + 0.5 * level], axis=1)
    result = dataset(
        CURVE,
        {
            **beside,
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
