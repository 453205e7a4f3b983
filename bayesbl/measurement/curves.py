"""Source of the gap curve (amplitude to gap): a named curve, a sweep of the bench, or none.

The bench is swept for the sampling rate, speed and length of each recording. Sweeps are stored by
content, so the same bench with the same needs is read from the store. All curves of a bench use the
same draws of its parameters. Unknown parameters therefore cancel in a change, also between
recordings of different speeds and rates.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from bayesbl.bench.bench import Bench, require_flank_change
from bayesbl.config.measurement import SnapshotConfig
from bayesbl.config.sections import PUBLISHED
from bayesbl.curve.gap_curve import GapCurve, Ringing, published_curve
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
from bayesbl.matching.observed import reference_speed
from bayesbl.matching.signals import SMALLEST_GAP_RAD
from bayesbl.measurement.compatibility import (
    bench_with,
    other_speed,
    require_one_speed_of_all,
    require_same_estimator,
)
from bayesbl.measurement.measurement import Measurer, Reason, Task, estimator_of
from bayesbl.probabilities import ends
from bayesbl.processes import processes
from bayesbl.progress import Progress, of_stage
from bayesbl.recording.checks import speed_in_another_unit
from bayesbl.recording.types import FloatArray, Recording
from bayesbl.results.store import read_tree, texts
from bayesbl.results.variables import Group, Variable, dataset, stack_snapshots, table
from bayesbl.results.work import WorkStore
from bayesbl.ringing.estimator import nominal_speed_rpm
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

    Parameters
    ----------
    curves
        One per recording. Different curves are stacked over the union of their amplitude ranges.
    rows
        For each recording, by source, the curve draw that each draw of δ used.
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

    Raises
    ------
    ResultError
        If the file is missing, damaged or unfinished.
    CurveError
        If the result holds no curve.
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

    def nominal(self, seed: np.random.SeedSequence, workers: int) -> SweepRow:
        """The row of the nominal bench.

        Raises
        ------
        BenchError
            If a simulation fails, or cannot be fitted.
        """
        generator = np.random.default_rng(seed)
        return self._row(
            None, lambda: sweep_nominal(self.bench, self.model, self.settings, generator, workers)
        )

    def draws(
        self,
        nominal: SweepRow,
        count: int,
        seed: np.random.SeedSequence,
        workers: int,
        progress: Progress | None = None,
    ) -> SweptDraws | None:
        """Sweep ``count`` benches drawn within the tolerances; ``None`` for a count of 0.

        The drawn benches depend on bench, count and seed alone. Two problems of one bench at
        different speeds or rates therefore draw the same benches.
        """
        if count == 0:
            return None
        tolerances = self.bench.tolerances
        benches = [self.bench.draw(np.random.default_rng(s)) for s in seed.spawn(count)]
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


GAPS, START_ANGLES = 20, 4
"""Gaps and start angles of a curve on demand. Against 60 gaps, 16 start angles and 5 rotations the
error of δ is far less than the uncertainty by the amplitude (``experiments/curve_counts.py``)."""

MOST_ROTATIONS = 3
"""Simulated load rotations: more change the fitted amplitude by less than 0.03 % of δ."""

DRAWS_PER_TERM = 3
"""Swept benches per term of the linear model in the parameters. With 24 benches for seven
parameters the curve's band is as wide as with 150, within 3 % (same command)."""

DEGREE = 3
SEED = 20260301
"""One seed for all curves on demand, so that the store serves runs of every seed."""

STORE = ".curves"
"""Folder beside the results that stores swept rows."""

MOST_KEPT = 5000
"""Rows in the store, some 10 kB each; the oldest are deleted first."""


@dataclass(frozen=True, slots=True)
class _Need:
    """What determines the curve of a recording, besides bench file and estimator.

    ``known``: bench values that differed when the recording was made.
    """

    reference_speed_rpm: float
    sampling_hz: float
    rotations: int
    known: tuple[tuple[str, float], ...]

    def __str__(self) -> str:
        return f"{self.sampling_hz:g} Hz at {abs(self.reference_speed_rpm):g} rpm"


class CurveMeasurer(Measurer):
    """A route that reads gaps from curves: a named one, one swept from the bench, or none.

    Attributes
    ----------
    named
        The published curve, or that of a sweep: one for all recordings.
    estimator
        Estimator of the ringing's amplitude.
    bench
        The bench to sweep for each recording, if no curve is named.

    Raises
    ------
    UserError
        If a named curve cannot be read.
    """

    def __init__(self, config: SnapshotConfig, bench: Bench | None) -> None:
        super().__init__(config)
        self.estimator = estimator_of(config)
        self.named: GapCurve | None = None
        if config.curve.source is not None:
            is_published = config.curve.source == PUBLISHED
            self.named = published_curve() if is_published else read_curve(config.curve.source)
            self.gap_range_rad = self.named.gap_range_rad
        elif bench is not None:
            self.gap_range_rad = (SMALLEST_GAP_RAD, SweepSettings().high_rad)
        self.bench = bench if self.named is None else None

    def describe_curve(self) -> str:
        """The name of the curve, or where it comes from."""
        if self.named is not None:
            return self.named.name
        if self.bench is not None:
            return f"swept from {self.config.estimator.bench} on demand"
        return "none, so the ringing alone: δ needs --bench FILE, or --curve RESULT of a sweep"

    def require_usable(self, recording: Recording) -> None:
        """Require that the named curve fits the estimator, or that the bench's gap shows.

        Raises
        ------
        UserError
            If not.
        """
        if self.named is not None:
            require_same_estimator(self.named, self.estimator, recording)
        elif (bench := self.bench_of(recording)) is not None:
            speed = self._need(recording, bench).reference_speed_rpm
            require_flank_change(bench, [speed], self.config.estimator.bench)

    def doubts(self, recording: Recording) -> Iterator[Reason]:
        """Yield why δ would be withheld whatever the fit: the curve belongs to another speed."""
        if self.named is None or self.config.curve.allow_extrapolation:
            return
        if (against := other_speed(recording, self.named)) is not None:
            if (question := self.question(recording)) is not None:
                yield question
            yield against

    def question(self, recording: Recording) -> Reason | None:
        """Ask whether the speed is in another unit, if that would explain why δ is withheld."""
        speed_rpm = None if self.named is None else self.named.reference_speed_rpm
        text = speed_in_another_unit(recording, speed_rpm)
        return None if text is None else Reason.of_text("speed_unit", text)

    def require_together(self, recordings: Sequence[Recording]) -> str | None:
        """Raise if the recordings cannot be compared; return the speed they share.

        With a bench, speeds and rates may differ, because each recording has its own curve.
        """
        if self.bench is not None or len(recordings) < 2:
            return None
        require_one_speed_of_all(recordings)
        return f"{nominal_speed_rpm(recordings[0]):.5g} rpm in all"

    def bench_of(self, recording: Recording) -> Bench | None:
        """The bench at the time of a recording; ``None`` if no curves are swept from a bench."""
        if self.bench is None:
            return None
        return bench_with(self.bench, self.config.entry_of(recording.name).bench)

    def curves(self, task: Task) -> list[GapCurve] | None:
        """The curve of each recording, read or swept, in order; ``None`` without one.

        Raises
        ------
        BenchError
            If a simulation fails.
        CurveError
            If A does not grow with δ.
        """
        if self.named is not None:
            return [self.named] * len(task.recordings)
        if self.bench is None:
            return None
        needs = [self._need(recording, self.bench) for recording in task.recordings]
        curve_of_need = {
            need: self._swept(need, task, recording)
            for need, recording in dict(zip(needs, task.recordings, strict=True)).items()
        }
        task.swept.keep_latest(count=MOST_KEPT)
        return [curve_of_need[need] for need in needs]

    def _need(self, recording: Recording, bench: Bench) -> _Need:
        entry = self.config.entry_of(recording.name)
        speed = reference_speed(recording, bench, entry.reference_speed_rpm)
        recorded_rotations = recording.duration_s / bench.rotation_period_s(speed)
        rotations = min(max(int(recorded_rotations), 2), MOST_ROTATIONS)
        # The fingerprint of an estimator distinguishes rates to three digits.
        sampling_hz = float(f"{1.0 / recording.sampling_period_s:.3g}")
        return _Need(speed, sampling_hz, rotations, tuple(sorted(entry.bench.items())))

    def _swept(self, need: _Need, task: Task, recording: Recording) -> GapCurve:
        bench = self.bench_of(recording)
        assert bench is not None
        bench = bench.with_parameters(reference_speed_rpm=need.reference_speed_rpm)
        model = self.estimator.model
        model = replace(model, ranges=model.lasting_ranges)
        settings = SweepSettings(
            low_rad=SMALLEST_GAP_RAD,
            count=GAPS,
            start_angles=START_ANGLES,
            rotations=need.rotations,
            sampling_hz=need.sampling_hz,
        )
        problem = SweepProblem(bench, model, settings, SEED, task.swept)
        nominal_seed, draw_seed, curve_seed = np.random.SeedSequence(SEED).spawn(3)
        workers = self.config.run.workers
        report = of_stage(task.progress, f"Making the curve for {need}")
        if report is not None:
            report(0, 1)
        nominal = problem.nominal(nominal_seed, workers)
        parameters = len(bench.tolerances)
        count = DRAWS_PER_TERM * (1 + parameters) if parameters else 0
        swept = problem.draws(nominal, count, draw_seed, workers, report)
        if report is not None:
            report(1, 1)
        curve = swept_curve(
            str(self.config.estimator.bench),
            nominal,
            model,
            DEGREE,
            self.estimator.fingerprint(recording),
            curve_seed,
            swept,
        )
        return replace(curve, reference_speed_rpm=abs(need.reference_speed_rpm))
