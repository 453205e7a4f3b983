"""Gap curves (amplitude to gap): how they are stored, and swept.

Sweeps are stored by content, so the same bench with the same needs is read from the store. All
curves of a bench use the same draws of its parameters. Unknown parameters therefore cancel in a
change, also between recordings of different speeds and rates.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from bayesbl.bench.bench import Bench
from bayesbl.curve.gap_curve import GapCurve, Ringing
from bayesbl.curve.sweep import (
    SweepRow,
    SweepSettings,
    SweptDraws,
    departures,
    sweep_like,
    sweep_nominal,
    swept_curve,
)
from bayesbl.errors import BenchError, CurveError
from bayesbl.probabilities import ends
from bayesbl.processes import processes
from bayesbl.progress import Progress
from bayesbl.recording.types import FloatArray
from bayesbl.results.store import read_tree, texts
from bayesbl.results.variables import Group, Variable, dataset, stack_snapshots, table
from bayesbl.results.work import LARGEST_STORE_BYTES, WorkStore
from bayesbl.ringing.symbols import DisturbanceModel

AMPLITUDES, BAND_DRAWS = 200, 1000
"""Amplitudes at which a curve is stored for figures, and curve draws behind its band."""

SOURCE_PREFIX = "source_"
"""Prefix of the stored variables that hold curve draws by one source of uncertainty."""

ROW_PREFIX = "row_"
"""Prefix of the stored variables that say which curve draw belongs to each draw of δ."""

BY_COEFFICIENTS = ("regression", "rounding")
"""Sources that are an uncertainty of the coefficients."""


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
    table("""
        coefficients (power) | rad / rpm^k | coefficient of A^k in the gap curve
        knots_rpm (knot) | rpm | amplitude of the impact ringing
        correction (knot) | 1 | departure of ln δ from the polynomial's
        start_angle_sd_rpm (knot) | rpm | scatter of the amplitude with the start angle
        log_frequency? (knot) | 1 | ln of ω in rad/s
        log_decay? (knot) | 1 | ln of τ in 1/s
        frequency_draws? (draw_bench, knot) | 1 | departures of ln ω for the bench draws
        decay_draws? (draw_bench, knot) | 1 | departures of ln τ for the bench draws
        scatter? (knot, row, column) | mixed | covariance of (A, ln ω, ln τ) over start angles
        delta_rad (amplitude) | rad | backlash gap, nominal
        low_rad (amplitude) | rad | lower bound of the curve's band
        high_rad (amplitude) | rad | upper bound of the curve's band
        covariance? (power, power_) | (rad / rpm^k)^2 | covariance of the coefficients
        coefficient_draws? (coefficient_draw, power) | rad / rpm^k
            | draws of the coefficients; source_NAME has those of the curve by source
    """),
    table("amplitude (amplitude) | rpm | amplitude of the impact ringing"),
    named=_source,
)
"""A gap curve. In a measurement it also has the curve draw that each draw of δ used.

δ = Σ coefficients·A^k · exp(correction + Σ source), at A = ``curve_amplitude_rpm`` of the
posterior. Correction and sources are linear in ln A between the knots. The row of each source is
the one that ``row_…`` names for the draw.
"""


def curves_group(
    names: Sequence[str],
    curves: Sequence[GapCurve],
    rows: Sequence[Mapping[str, NDArray[np.int64]]],
    level: float,
    seed: np.random.SeedSequence,
) -> xr.Dataset:
    """Group :data:`CURVE` of a measurement.

    ``curves``: one per recording. Different curves are stacked over the union of their amplitude
    ranges. ``rows``: for each recording, by source, the curve draw that each draw of δ used.
    """
    if all(curve is curves[0] for curve in curves):
        return curve_group(curves[0], level, seed, rows[0])
    ranges = np.array([curve.amplitude_range_rpm for curve in curves])
    ends = (float(ranges.min()), float(ranges.max()))
    parts = {
        name: {CURVE.name: curve_group(curve, level, seed, draw_rows, ends)}
        for name, curve, draw_rows in zip(names, curves, rows, strict=True)
    }
    return stack_snapshots(parts)[CURVE.name]


def curve_group(
    curve: GapCurve,
    level: float,
    seed: np.random.SeedSequence,
    rows: Mapping[str, NDArray[np.int64]] | None = None,
    range_rpm: tuple[float, float] | None = None,
) -> xr.Dataset:
    """Group :data:`CURVE`, with the band of its draws over ``range_rpm`` (the curve's by default).

    ``rows``: by source, the curve draw that each draw of δ used. ``None`` for a sweep, from which
    :func:`curve_from_dataset` restores the whole curve.
    """
    values: dict[str, object] = {}
    sources = curve.sources
    if rows is not None:
        # Single precision suffices for figures and checks; a sweep keeps all digits.
        sources = {name: draws.astype(np.float32) for name, draws in sources.items()}
        values |= {f"{ROW_PREFIX}{name}": draw_rows for name, draw_rows in rows.items()}
        drawn = coefficient_draws(curve)
        if drawn is not None:
            values |= {"coefficient_draws": drawn, "covariance": np.cov(drawn, rowvar=False)}
    values |= {f"{SOURCE_PREFIX}{name}": draws for name, draws in sources.items()}
    amplitude = np.geomspace(*(range_rpm or curve.amplitude_range_rpm), AMPLITUDES)
    draws = curve.draw(BAND_DRAWS, np.random.default_rng(seed))
    table = np.stack([draws.gap(np.full(BAND_DRAWS, a)) for a in amplitude])
    low, high = ends(table, level, 1)
    values |= {"delta_rad": curve.gap(amplitude), "low_rad": low, "high_rad": high}
    ringing = curve.ringing if rows is None else None
    result = dataset(CURVE, curve, ringing, values, {"amplitude": amplitude})
    result.attrs = {
        "name": curve.name,
        "fingerprint": curve.fingerprint or "",
        "warnings": list(curve.warnings),
        "reference_speed_rpm": curve.reference_speed_rpm or 0.0,
        "level": level,
    }
    return result


def coefficient_draws(curve: GapCurve) -> FloatArray | None:
    """Draws of the curve's coefficients within their uncertainty, shape (m, degree + 1).

    By relative least squares at the knots; ``None`` if no source is an uncertainty of the
    coefficients.
    """
    departures = [curve.sources[name] for name in BY_COEFFICIENTS if name in curve.sources]
    if not departures:
        return None
    nominal = polynomial.polyval(curve.knots_rpm, curve.coefficients)
    powers = curve.knots_rpm[:, None] ** np.arange(curve.coefficients.size)
    inverse = np.linalg.pinv(powers / nominal[:, None], rcond=1e-15)
    relative = np.expm1(np.sum(departures, axis=0))
    return np.asarray(curve.coefficients + relative @ inverse.T)


def curve_from_dataset(stored: xr.Dataset, name: str) -> GapCurve:
    """Restore the curve that :func:`curve_group` stored for a sweep, under a new name."""
    arrays = {str(key): variable.values for key, variable in stored.variables.items()}
    plain_fields = {f.name: arrays[f.name] for f in fields(GapCurve) if f.name in arrays}
    return GapCurve(
        name=name,
        sources={
            key.removeprefix(SOURCE_PREFIX): draws
            for key, draws in arrays.items()
            if key.startswith(SOURCE_PREFIX)
        },
        fingerprint=stored.attrs.get("fingerprint") or None,
        ringing=Ringing(**{f.name: arrays[f.name] for f in fields(Ringing)})
        if "log_frequency" in arrays
        else None,
        warnings=tuple(texts(stored.attrs.get("warnings"))),
        reference_speed_rpm=float(stored.attrs.get("reference_speed_rpm", 0.0)) or None,
        **plain_fields,
    )


def read_curve(path: str | Path) -> GapCurve:
    """Read the gap curve from the result of a sweep.

    Raises ResultError if the file is missing, damaged or unfinished, and CurveError if the result
    holds no curve.
    """
    tree = read_tree(path)
    if CURVE.name not in tree.children:
        raise CurveError(
            "This result holds no gap curve.",
            file=path,
            found=f'a result of kind "{tree.attrs.get("kind")}"',
            expected="the result.nc of a sweep",
        )
    return curve_from_dataset(tree[CURVE.name].to_dataset(), str(path))


@dataclass(frozen=True, slots=True)
class SweepProblem:
    """The inputs that determine every row of a sweep, and the store of finished rows."""

    bench: Bench
    model: DisturbanceModel
    settings: SweepSettings
    seed: int
    work: WorkStore

    def curve(
        self,
        name: str,
        degree: int,
        fingerprint: str,
        speed_rpm: float,
        count: int,
        workers: int,
        progress: Progress | None = None,
    ) -> tuple[GapCurve, SweepRow, SweptDraws | None]:
        """The gap curve, the row of the nominal bench, and those of ``count`` drawn benches.

        The curve belongs to ``speed_rpm``. The drawn benches depend on bench, count and seed alone,
        so two problems of one bench at different speeds or rates draw the same ones.

        Raises BenchError if a simulation fails, or cannot be fitted, and CurveError if A does not
        grow with δ.
        """
        nominal_seed, draw_seed, curve_seed = np.random.SeedSequence(self.seed).spawn(3)
        generator = np.random.default_rng(nominal_seed)
        nominal = self._row(
            None, lambda: sweep_nominal(self.bench, self.model, self.settings, generator, workers)
        )
        drawn = self._draws(nominal, draw_seed.spawn(count), workers, progress) if count else None
        curve = swept_curve(name, nominal, self.model, degree, fingerprint, curve_seed, drawn)
        self.work.keep_latest(size_bytes=LARGEST_STORE_BYTES)
        return replace(curve, reference_speed_rpm=speed_rpm), nominal, drawn

    def _draws(
        self,
        nominal: SweepRow,
        seeds: Sequence[np.random.SeedSequence],
        workers: int,
        progress: Progress | None,
    ) -> SweptDraws:
        """Sweep a bench drawn within the tolerances for each seed."""
        count, tolerances = len(seeds), self.bench.tolerances
        benches = [self.bench.draw(np.random.default_rng(seed)) for seed in seeds]
        names = tuple(tolerances)
        shifts = np.array(
            [[(b.value(n) - self.bench.value(n)) / tolerances[n] for n in names] for b in benches]
        )
        stored = [self.work.recall("sweep row", self._inputs(b), SweepRow) for b in benches]
        missing = [bench for bench, row in zip(benches, stored, strict=True) if row is None]
        rows = []
        # A few benches are swept faster than processes start.
        serial = workers == 1 or len(missing) < 2 * workers
        with nullcontext() if serial else processes(workers) as pool:
            swept = (map if pool is None else pool.map)(partial(self.drawn, nominal), missing)
            for row in stored:
                rows.append(departures(row or next(swept), nominal, self.model))
                if progress is not None:
                    progress(len(rows), count)
        return SweptDraws(names, shifts, np.array(rows), _root_of_shifts(self.bench))

    def drawn(self, nominal: SweepRow, bench: Bench) -> SweepRow:
        """The row of a bench that was drawn around the nominal one."""
        return self._row(bench, lambda: sweep_like(bench, nominal, self.model, self.settings))

    def _row(self, drawn: Bench | None, make: Callable[[], SweepRow]) -> SweepRow:
        """The row of the nominal or a drawn bench, from the store if an earlier sweep made it."""
        return self.work.get("sweep row", self._inputs(drawn), partial(_finite, make), SweepRow)

    def _inputs(self, drawn: Bench | None) -> tuple[object, ...]:
        """All inputs that determine a row."""
        benches = (self.bench.fingerprint(), None if drawn is None else drawn.fingerprint())
        return (*benches, self.model, self.settings, self.seed)


def _root_of_shifts(bench: Bench) -> FloatArray | None:
    """Cholesky factor of the covariance of the parameter shifts, to first order. ``None`` for a
    bench without identified parameters."""
    identified = bench.identified
    if identified is None:
        return None
    names = list(bench.tolerances)
    covariance = np.eye(len(names)) / 3.0  # variance of uniform shifts
    index = [names.index(name) for name in identified.names]
    scale = np.array([bench.value(name) / bench.tolerances[name] for name in identified.names])
    covariance[np.ix_(index, index)] = np.outer(scale, scale) * identified.covariance
    return np.asarray(np.linalg.cholesky(covariance))


def _finite(make: Callable[[], SweepRow]) -> SweepRow:
    row = make()
    if not np.all(np.isfinite(row.amplitude_rpm)):
        raise BenchError(
            "A simulated recording could not be fitted.",
            found="an amplitude that is not a number",
            expected="a bench whose gap shows in the motor speed",
        )
    return row
