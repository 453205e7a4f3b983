"""``kind = "fit"`` and ``"compare"``: measured recordings of one joint, and how they are
evaluated."""

from __future__ import annotations

import math
import re
from datetime import date as Date
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, Field, field_validator, model_validator

from bayesbl.config.sections import (
    BenchSource,
    CurveSource,
    GapBoundsFromZero,
    Interval,
    Items,
    Model,
    Positive,
    RecordedConfig,
    ResultFile,
    Section,
    SnapshotRecording,
    differing_in,
    refuse,
)
from bayesbl.errors import ConfigError
from bayesbl.units import conversion_factor, spelled

EXAMPLES = (
    'VALUE UNIT KIND: "3 arcmin play", "0.2 mrad delta", "0.5 mm play at 0.4 m" or '
    '"1 arcmin lost_motion at 3 %" (of the rated torque)'
)

_TEXT = re.compile(
    r"\s*(?P<value>[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)\s*(?P<unit>[^\s\d]+)"
    r"(?:\s+(?P<of>delta|δ|play|lost[ _]motion))?"
    r"(?:\s+at\s+(?P<at_m>\d+\.?\d*|\.\d+)\s*m)?"
    r"(?:\s+at\s+(?P<percent>\d+\.?\d*|\.\d+)\s*%)?\s*",
    re.IGNORECASE,
)


class Limit(Section):
    """``[joint.limit]``: when to repair, as data sheets state it; or as text, "3 arcmin play".

    ``play`` is 2 δ. ``lost_motion`` is the angle between the torques ± ``at_torque_share`` times
    ``rated_torque_nm``, with the stiffness of the bench. mm are at the radius ``at_m``.
    """

    # Lost motion at a share s of the rated torque T is play and what the stiffness K at the load
    # gives way between +s T and −s T: 2 δ + 2 s T / K.
    value: Positive
    unit: Literal["rad", "mrad", "deg", "arcmin", "arcsec", "mm"]
    of: Literal["delta", "play", "lost_motion"]
    at_m: Positive | None = None
    at_torque_share: Annotated[float, Field(gt=0.0, lt=1.0)] | None = None

    @model_validator(mode="before")
    @classmethod
    def _of_text(cls, limit: Any) -> Any:
        if not isinstance(limit, str):
            return limit
        parts = _TEXT.fullmatch(limit)
        if parts is None:
            refuse("This is no limit.", found=f'"{limit}"', expected=EXAMPLES)
        if parts["of"] is None:
            problem = "A limit says whether it is of δ, of play (2 δ) or of lost motion."
            refuse(problem, found=f'"{limit}"', expected=EXAMPLES)
        given = {
            "value": float(parts["value"]),
            "unit": spelled(parts["unit"]),
            "of": parts["of"].lower().replace(" ", "_").replace("δ", "delta"),
            "at_m": parts["at_m"] and float(parts["at_m"]),
            "at_torque_share": parts["percent"] and float(parts["percent"]) / 100.0,
        }
        return {key: value for key, value in given.items() if value is not None}

    def require_sound(self) -> None:
        if (self.unit == "mm") != (self.at_m is not None):
            actual = "no radius" if self.at_m is None else f"a radius with {self.unit}"
            refuse("Limits in mm, and only these, have a radius.", found=actual, expected=EXAMPLES)
        if (self.of == "lost_motion") != (self.at_torque_share is not None):
            actual = "no torque" if self.at_torque_share is None else f"a torque with {self.of}"
            refuse(
                "Limits of lost motion, and only these, have a torque.",
                found=actual,
                expected=EXAMPLES,
            )

    def __str__(self) -> str:
        radius = "" if self.at_m is None else f" at {self.at_m!r} m"
        share = self.at_torque_share
        torque = "" if share is None else f" at {float(f'{100.0 * share:.12g}')!r} %"
        return f"{self.value!r} {self.unit} {self.of}{radius}{torque}".replace(".0 ", " ")

    @property
    def name(self) -> str:
        """Unit and kind, as a measured value in them is labelled: ``arcmin of play``."""
        _, unit, kind = str(self).split(" ", 2)
        return f"{unit} of {kind.replace('_', ' ').replace('delta', 'δ')}"

    def windup_rad(self, torque_nm: float | None, stiffness_nm_per_rad: float | None) -> float:
        """Wind-up between the torques of a lost motion; 0 for other limits.

        Raises ConfigError without rated torque or stiffness.
        """
        if self.at_torque_share is None:
            return 0.0
        if torque_nm is None or stiffness_nm_per_rad is None:
            raise ConfigError(
                "Lost motion needs the rated torque and the joint's stiffness.",
                where="[joint] limit",
                found="no rated torque" if torque_nm is None else "no stiffness",
                expected="rated_torque_nm = 50.0 under [joint], and a bench with "
                "shaft_stiffness_nm_per_rad; or a limit of play or delta",
            )
        return 2.0 * self.at_torque_share * torque_nm / stiffness_nm_per_rad

    def delta_rad(self, windup_rad: float = 0.0) -> float:
        """The gap at this limit, rad. Raises ConfigError if the wind-up alone exceeds the limit."""
        whole = self.value * self._rad
        delta = whole if self.of == "delta" else 0.5 * (whole - windup_rad)
        if delta <= 0.0:
            raise ConfigError(
                "This limit leaves no room for a gap.",
                where="[joint] limit",
                found=f"{self}, of which {1e3 * windup_rad:.3g} mrad are wind-up",
                expected=f"more than {windup_rad / self._rad:.3g} {self.unit}",
            )
        return delta

    def stated(self, delta_rad: float, windup_rad: float = 0.0) -> float:
        """A gap in the unit and kind of this limit: the inverse of :meth:`delta_rad`."""
        return (delta_rad if self.of == "delta" else 2.0 * delta_rad + windup_rad) / self._rad

    @property
    def _rad(self) -> float:
        return conversion_factor("_rad", self.unit) if self.at_m is None else 1e-3 / self.at_m


LARGEST_LIMIT_RAD = 0.05  # Nearly 3°, more than any joint whose gap its ringing can show


def _a_gap(limit_rad: float) -> float:
    if limit_rad > LARGEST_LIMIT_RAD:
        text = f"{limit_rad:g}"
        meant = ""
        if limit_rad <= 1e3 * LARGEST_LIMIT_RAD:
            meant = f" Did you mean {text}e-3 rad = {text} mrad?"
        refuse(
            f"limit_rad = {text} is {1e3 * limit_rad:.6g} mrad "
            f"({math.degrees(limit_rad):.3g}°).{meant}",
            expected=f"a gap in rad, at most {LARGEST_LIMIT_RAD:g}",
        )
    return limit_rad


def _of_a_gap(limit: Limit) -> Limit:
    if (largest := limit.delta_rad()) > LARGEST_LIMIT_RAD:
        refuse(
            "This limit is larger than any gap that bayesbl measures.",
            found=f"{limit}, {1e3 * largest:.4g} mrad of δ",
            expected=f"at most {1e3 * LARGEST_LIMIT_RAD:g} mrad",
        )
    return limit


LimitRad = Annotated[Positive, AfterValidator(_a_gap)]
StatedLimit = Annotated[Limit, AfterValidator(_of_a_gap)]


class Joint(Section):
    """``[joint]``: what you know about the joint.

    ``drift``: the relative standard deviation by which each bench parameter or effect may drift
    from the first snapshot to each later one, instead of the default; 0 means no drift. Lost motion
    is stated at 3 % of ``rated_torque_nm``, at the output. ``limit_rad`` is a limit of δ in rad;
    ``limit`` is one of δ, play or lost motion in the unit of a data sheet. ``upright``: gravity
    does not turn the joint, because its axis is vertical or its load is balanced.
    """

    gear_ratio: Positive | None = None
    upright: bool = False
    rated_torque_nm: Positive | None = None
    limit_rad: LimitRad | None = None
    limit: StatedLimit | None = None
    decide_before: Date | None = None
    drift: dict[str, Annotated[float, Field(ge=0.0, le=1.0)]] = Field(default_factory=dict)

    def require_sound(self) -> None:
        if self.limit is not None and self.limit_rad is not None:
            refuse(
                "There are two limits.",
                found="limit and limit_rad",
                expected="one of them",
                at=("limit",),
            )
        if self.decide_before is not None and self.limit_rad is None and self.limit is None:
            refuse(
                "A decision date needs a limit for the gap.",
                found="decide_before without limit_rad",
                expected="limit_rad beside it, e.g. limit_rad = 1.2e-3 (--limit-rad 1.2e-3)",
                at=("decide_before",),
            )


class Search(Section):
    """``[estimator.search]``: how the optimum is found.

    ``start_from`` is an earlier result whose optimum starts the search. ``paper`` also searches
    eq. 6 in the ranges of Table 2, as printed.
    """

    method: Literal["guess", "paper"] = "guess"
    start_from: ResultFile | None = None

    def require_sound(self) -> None:
        if self.method != "guess" and self.start_from is not None:
            refuse(
                "A search of all of Table 2's ranges does not start from an earlier result.",
                found=f'method = "{self.method}" with start_from = "{self.start_from}"',
                expected='method = "guess", or no start_from',
            )


class Noise(Section):
    """``[estimator.noise]``: what is assumed about the noise; ``order`` belongs to ``ar``."""

    kind: Literal["auto", "white", "ar", "student_t"] = "auto"
    order: int | None = Field(default=None, ge=1, le=15)

    def require_sound(self) -> None:
        if self.order is not None and self.kind != "ar":
            refuse(
                "An order belongs to autoregressive noise.",
                found=f'order = {self.order} with kind = "{self.kind}"',
                expected='kind = "ar", or no order',
            )


WITHOUT_BENCH = ("torque_ramp", "two_encoders")  # routes that need only recordings


class Estimator(Section):
    """``[estimator]``: how δ is estimated.

    ``auto`` runs the amplitude and direct routes; the direct one answers if its checks pass.
    ``torque_ramp`` and ``two_encoders`` need neither bench nor curve. ``gap_rad`` is the range of
    the direct route's prior: log-uniform, or uniform in ln(δ + 0.01 mrad) if it begins at zero.
    """

    route: Literal["auto", "amplitude", "direct", "torque_ramp", "two_encoders"] = "amplitude"
    bench: BenchSource | None = None
    gap_rad: GapBoundsFromZero = (0.0, 1e-2)
    model: Model = Field(default_factory=Model)
    search: Search = Field(default_factory=Search)
    noise: Noise = Field(default_factory=Noise)

    @model_validator(mode="before")
    @classmethod
    def _auto_with_a_bench(cls, value: Any) -> Any:
        if isinstance(value, dict) and "bench" in value:
            return {"route": "auto", **value}
        return value

    def require_sound(self) -> None:
        if self.route not in ("amplitude", *WITHOUT_BENCH) and self.bench is None:
            refuse(
                "This route needs a bench.",
                found=f'route = "{self.route}" without a bench',
                expected='bench = "bench.toml" (--bench bench.toml)',
                at=("route",),
            )
        if self.search.method != "guess" and self.model.baseline_harmonics != 0:
            refuse(
                "The paper's search has no baseline.",
                found=f'method = "{self.search.method}" with '
                f"{self.model.baseline_harmonics} harmonics",
                expected="baseline_harmonics = 0 in [estimator.model]",
            )


class Posterior(Section):
    """``[posterior]``: how many independent ensembles sample, and when they stop."""

    ensembles: int = Field(default=4, ge=2, le=64)
    max_steps: int = Field(default=20_000, ge=100)
    check_sampler: bool = False


class Curve(Section):
    """``[curve]``: the gap curve. ``source`` is the result of a sweep, or ``"published"``.

    Without a source, the curve is swept from the estimator's bench; without a bench there is no δ.
    The direct route ignores a source.
    """

    source: CurveSource | None = None
    allow_extrapolation: bool = False


class KnownGap(Section):
    """``[recordings.known_gap]``: the gap δ at the date of the recording, as two encoders or a dial
    gauge measured it."""

    delta_rad: Positive
    sd_rad: Positive


class MeasuredRecording(SnapshotRecording):
    """A recording of the joint.

    ``files``: for ramps of torque, one file for each position around the turn. ``repaired`` marks
    the first recording after a repair. ``bench``: values that differed from the bench file at that
    date, by ``parameter`` or ``"effect.parameter"``. ``known_gap`` scales the curve of the
    amplitude route.
    """

    known_gap: KnownGap | None = None


class WearOverDates(Section):
    """``[wear]``: what you know about wear.

    ``relative_sd_per_date``: relative standard deviation by which temperature, grease or the torque
    constant may move the measured gap from date to date. ``in_service_since``: when the joint, or
    the part that its last repair replaced, went into service.
    """

    relative_sd_per_date: float = Field(default=0.0, ge=0.0, le=0.5)
    in_service_since: Date | None = None


class SnapshotConfig(RecordedConfig):
    """A run over measured recordings of one joint."""

    least_recordings: ClassVar[int] = 1
    most_recordings: ClassVar[int | None] = None

    joint: Joint = Field(default_factory=Joint)
    recordings: Items[MeasuredRecording]
    estimator: Estimator = Field(default_factory=Estimator)
    posterior: Posterior = Field(default_factory=Posterior)
    interval: Interval = Field(default_factory=Interval)
    curve: Curve = Field(default_factory=Curve)

    @field_validator("recordings")
    @classmethod
    def _right_number(
        cls, recordings: tuple[MeasuredRecording, ...]
    ) -> tuple[MeasuredRecording, ...]:
        count, least, most = len(recordings), cls.least_recordings, cls.most_recordings
        if count < least or (most is not None and count > most):
            refuse(
                "This kind of run needs a different number of recordings.",
                found=f"{count} recording{'' if count == 1 else 's'}",
                expected=f"exactly {least}" if least == most else f"at least {least}",
            )
        return differing_in("name")(recordings)

    def entry_of(self, recording: str) -> MeasuredRecording:
        """The entry with this name."""
        return next(entry for entry in self.recordings if entry.name == recording)

    def require_sound(self) -> None:
        """Refuse, rather than ignore, what the route does not use."""
        route, by_bench = self.estimator.route, self.estimator.bench is not None
        by_amplitude, by_curve = route == "amplitude", self.curve.source is not None
        alone = route in WITHOUT_BENCH
        unused: dict[tuple[str | int, ...], object] = {
            ("estimator", "bench"): alone and by_bench,
            ("curve", "source"): alone and by_curve,
            ("estimator", "search", "start_from"): not by_amplitude
            and self.estimator.search.start_from,
            ("posterior", "check_sampler"): not by_amplitude and self.posterior.check_sampler,
        }
        for n, recording in enumerate(self.recordings):
            by_value = by_bench and not (by_amplitude and by_curve)
            unused |= {
                ("recordings", n, "files"): len(recording.every_file) > 1
                and route != "torque_ramp",
                ("recordings", n, "reference_speed_rpm"): alone
                and recording.reference_speed_rpm is not None,
                ("recordings", n, "bench"): recording.bench and not by_value,
                ("recordings", n, "known_gap"): not by_amplitude and recording.known_gap,
            }
        for at, is_given in unused.items():
            if is_given:
                without = "" if by_bench else " and without a bench"
                refuse(
                    f'This has no use with route = "{route}"{without}.',
                    found=at[-1],
                    expected=f"no {at[-1]}, or another route",
                    at=at,
                )


class FitConfig(SnapshotConfig):
    """``kind = "fit"``: one recording."""

    least_recordings = 1
    most_recordings = 1

    kind: Literal["fit"]

    def require_sound(self) -> None:
        super().require_sound()
        if self.joint.decide_before is not None:
            refuse(
                "One recording gives no rate of wear, so it says nothing about a later date.",
                found=f"decide_before = {self.joint.decide_before}",
                expected='kind = "compare" with two dated recordings or more',
                at=("joint", "decide_before"),
            )


class CompareConfig(SnapshotConfig):
    """``kind = "compare"``: snapshots of one joint in the order they were taken.

    Where all have a date, the dates give the order.
    """

    least_recordings = 2

    kind: Literal["compare"]
    wear: WearOverDates = Field(default_factory=WearOverDates)

    @property
    def dates(self) -> tuple[Date, ...] | None:
        """Date of each recording; ``None`` unless all are dated."""
        dates = tuple(one.date for one in self.recordings if one.date is not None)
        return dates if len(dates) == len(self.recordings) else None

    @field_validator("recordings")
    @classmethod
    def _by_date(cls, recordings: tuple[MeasuredRecording, ...]) -> tuple[MeasuredRecording, ...]:
        undated = [i for i, recording in enumerate(recordings) if recording.date is None]
        if 0 < len(undated) < len(recordings):
            names = ", ".join(f'"{recordings[i].name}"' for i in undated)
            refuse(
                "Some recordings have a date and some have none: every one needs its date, or "
                "none.",
                found=f"no date for {names}",
                expected="date = 2026-03-01 in every [[recordings]], or in none",
                at=(undated[0],),
            )
        return tuple(sorted(recordings, key=lambda one: one.date or Date.min))

    def require_sound(self) -> None:
        super().require_sound()
        before, start, dates = self.joint.decide_before, self.wear.in_service_since, self.dates
        repairs = [n for n, recording in enumerate(self.recordings) if recording.repaired]
        if dates is None:
            undated: tuple[tuple[object, str, tuple[str | int, ...]], ...] = (
                (repairs, "A rate of wear since a repair", ("recordings", *repairs[:1])),
                (self.wear != WearOverDates(), "[wear]", ("wear",)),
                (before, "A decision date", ("joint", "decide_before")),
            )
            for asked, what, at in undated:
                if asked:
                    refuse(
                        f"{what} needs dated recordings.",
                        found="no dates",
                        expected="date = 2026-03-01 in every [[recordings]], or --date for each",
                        at=at,
                    )
            return
        first = dates[repairs[-1]] if repairs else dates[0]
        if start is not None and start > first:
            refuse(
                "The joint cannot have gone into service after its first recording.",
                found=f"in_service_since = {start}, first recording {first}",
                expected="an earlier date, or none where it is not known",
                at=("wear", "in_service_since"),
            )
        if before is not None and before <= dates[-1]:
            refuse(
                "The decision date is not after the last recording.",
                found=f"decide_before = {before}, last recording {dates[-1]}",
                expected="a later date",
                at=("joint", "decide_before"),
            )
