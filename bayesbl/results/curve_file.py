"""Gap curves in NetCDF: everything that a later comparison needs of a sweep."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from bayesbl.curve.gap_curve import GapCurve, Ringing
from bayesbl.errors import CurveError, ResultError
from bayesbl.results.store import read_tree, texts
from bayesbl.results.tree import dataset

GROUP = "gap_curve"


def curve_to_dataset(curve: GapCurve) -> xr.Dataset:
    """The curve as a dataset; :func:`curve_from_dataset` gives it back."""
    variables: dict[str, tuple[tuple[str, ...], np.ndarray, str, str]] = {
        "coefficients": (
            ("power",),
            curve.coefficients,
            "rad / rpm^k",
            "coefficient of A^k in the gap curve",
        ),
        "knots_rpm": (("knot",), curve.knots_rpm, "rpm", "amplitude of the impact ringing"),
        "correction": (("knot",), curve.correction, "1", "departure of ln δ from the polynomial's"),
        "start_angle_sd_rpm": (
            ("knot",),
            curve.start_angle_sd_rpm,
            "rpm",
            "scatter of the amplitude with the start angle",
        ),
    }
    for name, draws in curve.sources.items():
        variables[f"source_{name}"] = (
            (f"draw_{name}", "knot"),
            draws,
            "1",
            f"departures of ln δ from the curve, source {name}",
        )
    if curve.ringing is not None:
        variables |= _ringing(curve.ringing)
    result = dataset(variables)
    result.attrs = {
        "name": curve.name,
        "fingerprint": curve.fingerprint or "",
        "warnings": list(curve.warnings),
        "reference_speed_rpm": curve.reference_speed_rpm or 0.0,
    }
    return result


def curve_from_dataset(stored: xr.Dataset, name: str) -> GapCurve:
    """The curve that :func:`curve_to_dataset` stored, under a new name."""
    ringing = None
    if "log_frequency" in stored:
        ringing = Ringing(
            *(
                stored[key].values
                for key in (
                    "log_frequency",
                    "log_decay",
                    "frequency_draws",
                    "decay_draws",
                    "scatter",
                )
            )
        )
    return GapCurve(
        name=name,
        coefficients=stored["coefficients"].values,
        knots_rpm=stored["knots_rpm"].values,
        correction=stored["correction"].values,
        sources={
            str(key).removeprefix("source_"): stored[key].values
            for key in stored.data_vars
            if str(key).startswith("source_")
        },
        start_angle_sd_rpm=stored["start_angle_sd_rpm"].values,
        fingerprint=stored.attrs.get("fingerprint") or None,
        ringing=ringing,
        warnings=tuple(texts(stored.attrs.get("warnings"))),
        reference_speed_rpm=float(stored.attrs.get("reference_speed_rpm", 0.0)) or None,
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
    if GROUP not in tree.children:
        raise CurveError(
            "This result holds no gap curve.",
            file=path,
            found=f'a result of kind "{tree.attrs.get("kind")}"',
            expected="the result.nc of a sweep",
        )
    try:
        return curve_from_dataset(tree[GROUP].to_dataset(), str(path))
    except KeyError as missing:
        raise ResultError(
            "The stored gap curve is incomplete.", file=path, found=f"no {missing}"
        ) from None


def _ringing(ringing: Ringing) -> dict[str, tuple[tuple[str, ...], np.ndarray, str, str]]:
    return {
        "log_frequency": (("knot",), ringing.log_frequency, "1", "ln of ω in rad/s"),
        "log_decay": (("knot",), ringing.log_decay, "1", "ln of τ in 1/s"),
        "frequency_draws": (
            ("draw_bench", "knot"),
            ringing.frequency_draws,
            "1",
            "departures of ln ω for the bench draws",
        ),
        "decay_draws": (
            ("draw_bench", "knot"),
            ringing.decay_draws,
            "1",
            "departures of ln τ for the bench draws",
        ),
        "scatter": (
            ("knot", "row", "column"),
            ringing.scatter,
            "mixed",
            "covariance of (A, ln ω, ln τ) over start angles",
        ),
    }
