"""The configuration models of all kinds, except those of measurements and benches."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping
from datetime import date as Date
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo, field_validator

from bayesbl.config.measurement import (
    CompareConfig,
    Curve,
    FitConfig,
    Noise,
    Posterior,
    WearOverDates,
)
from bayesbl.config.sections import (
    SHORTEST_WAY_RAD,
    AngleRange,
    BenchSource,
    ChannelName,
    ClusterRun,
    Gap,
    GapBounds,
    GapBoundsFromZero,
    InputPath,
    Interval,
    Items,
    Model,
    Name,
    OutputPath,
    Positive,
    RecordedConfig,
    RunConfig,
    Section,
    Seed,
    SnapshotRecording,
    Workers,
    differing_in,
    known_name,
    refuse,
    require_different,
    resolve,
)


class _PointToPoint(Section):
    """What motions from point to point share: the motor's speed, acceleration and rests.

    Trapezoids in speed; S-curves where the jerk is limited.
    """

    speed_rpm: Positive
    acceleration_rpm_per_s: Positive
    jerk_rpm_per_s2: Positive | None = None
    dwell_s: float = Field(default=0.15, ge=0.0)
    duration_s: Positive


class StrokesMotion(_PointToPoint):
    """Between two load angles and back."""

    kind: Literal["strokes"]
    range_rad: AngleRange


def _that_move(points: tuple[float, ...]) -> tuple[float, ...]:
    following = points[1:] + points[:1]
    if len(points) < 2 or any(
        abs(b - a) < SHORTEST_WAY_RAD for a, b in zip(points, following, strict=True)
    ):
        refuse(
            "Successive points of a cycle must differ.",
            found=list(points),
            expected="two load angles or more in rad, each different from the one before",
        )
    return points


class CycleMotion(_PointToPoint):
    """Through some load angles in turn, over and over."""

    kind: Literal["cycle"]
    points_rad: Annotated[Items[float], AfterValidator(_that_move)]


class SineMotion(Section):
    """To and fro between two load angles, the angle a sine over time."""

    kind: Literal["sine"]
    range_rad: AngleRange
    period_s: Positive
    duration_s: Positive


class TorqueRampMotion(Section):
    """The motor's torque to and fro with the output held: some cycles at each amplitude."""

    kind: Literal["torque_ramp"]
    torque_nm: Annotated[Items[Positive], Field(min_length=1)]
    cycles: int = Field(default=5, ge=1)
    period_s: Positive = 4.0
    start_angle_rad: float = 0.0

    @property
    def duration_s(self) -> float:
        """Duration of all cycles."""
        return len(self.torque_nm) * self.cycles * self.period_s


MotionSection = Annotated[
    StrokesMotion | CycleMotion | SineMotion | TorqueRampMotion, Field(discriminator="kind")
]


class SimulatedRecording(Section):
    """A recording to simulate: in steady rotation, or in a ``motion``.

    The ``kind`` of a ``motion`` is ``strokes``, ``cycle``, ``sine`` or ``torque_ramp``. A start
    angle that is not given is drawn. ``truth_file`` names a file for the true values.
    """

    name: Name
    file: str = Field(min_length=1)
    gap_rad: Gap
    reference_speed_rpm: float | None = None
    rotations: Positive = 5.0
    sampling_hz: Positive = 1000.0
    start_angle_rad: float | None = None
    motor_start_angle_rad: float | None = None
    motion: MotionSection | None = None

    def require_sound(self) -> None:
        steady = {"rotations", "reference_speed_rpm", "start_angle_rad"} & self.model_fields_set
        if self.motion is not None and steady:
            refuse(
                "A motion has its own speed, length and start.",
                found=f"motion and {', '.join(sorted(steady))}",
                expected="motion alone, or steady rotation without it",
            )


class SimulateRun(Section):
    """Without ``output``, a simulation writes its files beside the configuration."""

    seed: Seed = 1
    workers: Workers = 1
    output: OutputPath | None = None


class SimulateFile(Section):
    """``kind = "simulate"``."""

    schema_version: Literal[1] = Field(alias="schema")
    kind: Literal["simulate"]
    run: SimulateRun = SimulateRun()
    bench: BenchSource
    truth_file: str | None = Field(default=None, min_length=1)
    recordings: Annotated[
        Items[SimulatedRecording],
        Field(min_length=1),
        AfterValidator(differing_in("name", "file")),
    ]


_PLACES = {"{joint}", "{date}"}


def _source_of_recordings(value: object, info: ValidationInfo) -> str:
    """The pattern or the table as an absolute path."""
    if not isinstance(value, str) or not value.strip() or "\0" in value:
        refuse("This is neither a pattern nor a table of recordings.", expected="text")
    places = set(re.findall(r"\{[^{}]*\}", value))
    if re.match(r"[a-z][a-z0-9+.-]+://", value):
        refuse("Recordings are files.", expected="a folder that they are copied to")
    if places == _PLACES:
        return str(resolve(value, info))
    if places or "*" in value:
        refuse(
            "This pattern does not contain the joint and the date of a file.",
            expected='{joint} and {date} once each, as in "data/{joint}/{date}.csv", or a table '
            "with the columns joint, date and file",
        )
    return str(_table(value, info))


def _table(value: object, info: ValidationInfo) -> object:
    path = resolve(str(value), info)
    if path.suffix.lower() != ".csv":
        refuse("This is no table.", found=path, expected="a file in .csv")
    if not path.is_file():
        refuse("There is no such file.", found=path, expected="an existing file")
    return path


class FleetSection(Section):
    """``[fleet]``: inventory and recordings.

    ``recordings`` is a pattern with ``{joint}`` and ``{date}``, or a table with the columns
    ``joint``, ``date`` and ``file``. Joints with the same entry in ``pool_by``, a column of the
    inventory, share information. ``covariates`` are columns of numbers, such as a load, that may
    affect the rates.
    """

    joints: Annotated[InputPath, BeforeValidator(_table)]
    recordings: Annotated[str, BeforeValidator(_source_of_recordings)]
    pool_by: str | None = None
    covariates: Items[str] = ()
    decide_before: Date | None = None

    def require_sound(self) -> None:
        if self.covariates and self.pool_by is None:
            refuse(
                "Covariates are learned from joints of one type.",
                found="covariates without pool_by",
                expected='pool_by as well, e.g. "gearbox"',
                at=("covariates",),
            )
        require_different(self.covariates, "Two covariates are the same.")

    @property
    def is_pattern(self) -> bool:
        """Whether a pattern finds the recordings."""
        return "{joint}" in self.recordings


class FleetEstimator(Section):
    """``[estimator]`` of a fleet: as in a comparison, but the inventory states bench and curve.

    ``route`` applies to joints with a bench; others use the amplitude route.
    """

    route: Literal["auto", "amplitude", "direct"] = "auto"
    gap_rad: GapBoundsFromZero = (0.0, 1e-2)
    model: Model = Field(default_factory=Model)
    noise: Noise = Field(default_factory=Noise)


class FleetConfig(RecordedConfig):
    """``kind = "fleet"``: every recording of every joint, measured once."""

    kind: Literal["fleet"]
    run: ClusterRun
    fleet: FleetSection
    estimator: FleetEstimator = Field(default_factory=FleetEstimator)
    posterior: Posterior = Field(default_factory=Posterior)
    interval: Interval = Field(default_factory=Interval)
    curve: Curve = Field(default_factory=Curve)
    wear: WearOverDates = Field(default_factory=WearOverDates)

    def require_sound(self) -> None:
        for value, what, at in (
            (self.curve.source, "A curve", ("curve", "source")),
            (self.wear.in_service_since, "in_service_since", ("wear", "in_service_since")),
        ):
            if value is not None:
                refuse(
                    f"{what} belongs to a joint, not to a fleet.",
                    found=value,
                    expected=f"a column {at[-1].replace('source', 'curve')} of the inventory",
                    at=at,
                )


Method = Literal["forward", "inverse", "free_motion"]


def effect_name(name: str) -> str:
    """The name of an effect; refused if it is unknown."""
    # Imported here: the catalogue needs the compiled simulator, which takes a second.
    from bayesbl.bench.effects import EFFECT_BY_NAME

    return known_name(name, EFFECT_BY_NAME, "effect")


def bench_parameter(name: str) -> str:
    """The name of a bench parameter; refused if it is unknown."""
    from bayesbl.bench.parameters import PARAMETER_INFO

    return known_name(name, PARAMETER_INFO, "bench parameter")


def word_or_names(
    word: str, what: str, known: Callable[[str], str], fewest: int = 1
) -> BeforeValidator:
    """Validate a word or a list of names before the union does, which would report every branch."""

    def read(value: object) -> object:
        if value == word:
            return value
        if not isinstance(value, list | tuple) or len(value) < fewest:
            refuse(
                f"This is not a list of {what}.", expected=f'"{word}", or names in brackets: ["…"]'
            )
        return tuple(known(str(name)) for name in value)

    return BeforeValidator(read)


def _in_newton_metres(names: tuple[str, ...]) -> tuple[str, ...]:
    for name in names:
        if not name.endswith("_nm"):
            refuse(
                "A known torque is given in N m at the motor.",
                found=f'"{name}"',
                expected="a name ending in _nm; map the column to one under [columns]",
            )
    return names


class Compared(Section):
    """``[comparison]``: how simulation and recordings are compared.

    Without ``channels``, all recorded ones are compared. ``known_torque`` names columns (N m at the
    motor) that are added to the torque that the bench needs. ``cutoff_hz`` is for the zero-phase
    filter of both sides of the inverse method; by default, it is the frequency at which prediction
    and measurement lose coherence. ``load_angle_known`` and ``motor_angle_known`` say that the
    recorded position is absolute.
    """

    method: Method = "forward"
    channels: Items[ChannelName] = ()
    known_torque: Annotated[Items[str], AfterValidator(_in_newton_metres)] = ()
    load_angle_known: bool = False
    motor_angle_known: bool = False
    cutoff_hz: Positive | None = None


class Unknowns(Section):
    """``[unknowns]``: what is fitted in any case."""

    gap_rad: GapBounds | None = None
    bench_parameters: Items[Annotated[str, AfterValidator(bench_parameter)]] = ()


class DiagnosedRecording(SnapshotRecording):
    """As in a comparison, without ``known_gap``.

    ``use = "split"`` fits the first half of the recording and predicts the second.
    """

    use: Literal["fit", "hold_out", "split"] = "fit"


class Candidates(Section):
    """``[candidates]``: effects that may be named, and how many.

    The default of ``max_effects`` is three in the closed loop, where each costs many simulations,
    else six. ``false_alarm``: how often noise counts as a line in the speed of a rigid drive.
    """

    effects: Annotated[
        Literal["all"] | tuple[str, ...], word_or_names("all", "effects", effect_name)
    ] = "all"
    max_effects: int | None = Field(default=None, ge=1, le=10)
    false_alarm: float = Field(default=0.01, gt=0.0, le=0.5)


class DiagnoseConfig(RecordedConfig):
    """``kind = "diagnose"``."""

    kind: Literal["diagnose"]
    bench: BenchSource
    comparison: Compared = Field(default_factory=Compared)
    unknowns: Unknowns = Field(default_factory=Unknowns)
    recordings: Annotated[Items[DiagnosedRecording], AfterValidator(differing_in("name"))]
    candidates: Candidates = Field(default_factory=Candidates)
    interval: Interval = Field(default_factory=Interval)

    def require_sound(self) -> None:
        uses = {recording.use for recording in self.recordings}
        if "split" not in uses and uses != {"fit", "hold_out"}:
            missing = "held out" if "fit" in uses else "to fit on"
            refuse(
                f"There is nothing {missing}: held-out data show how much of the disagreement an "
                "effect removes.",
                found=", ".join(f'{r.name}: use = "{r.use}"' for r in self.recordings)
                or "no recordings",
                expected='use = "hold_out" for one recording, or "split"',
            )


class GapRange(Section):
    """``[sweep] gap_rad``: the gaps over which a bench is swept."""

    low: Positive = 1e-4
    high: Positive = 4e-3
    count: int = Field(default=40, ge=6, le=1000)
    spacing: Literal["log", "linear"] = "log"

    def require_sound(self) -> None:
        if not self.low < self.high:
            refuse(
                "The range of gaps is empty.",
                found=f"low = {self.low:g}, high = {self.high:g}",
                expected="low < high",
            )


class Sweep(Section):
    """``[sweep]``: which recordings are simulated, and the polynomial through them."""

    gap_rad: GapRange = Field(default_factory=GapRange)
    start_angles: int = Field(default=4, ge=2, le=100)
    rotations: float = Field(default=5.0, ge=2.0, le=100.0)
    sampling_hz: float = Field(default=1000.0, ge=100.0)
    bench_draws: int = Field(default=0, ge=0, le=10_000)
    degree: int = Field(default=3, ge=1, le=8)

    @field_validator("degree")
    @classmethod
    def _fewer_than_gaps(cls, degree: int, info: ValidationInfo) -> int:
        gap_rad = info.data.get("gap_rad")  # absent if it was refused itself
        if gap_rad is not None and gap_rad.count < degree + 3:
            refuse(
                "The sweep has too few gaps for this degree.",
                found=f"degree = {degree} with gap_rad.count = {gap_rad.count}",
                expected=f"gap_rad.count of at least {degree + 3}, or a degree of at most "
                f"{gap_rad.count - 3}",
            )
        return degree


class SweepEstimator(Section):
    """``[estimator]`` of a sweep: what defines A."""

    model: Model = Field(default_factory=Model)


class SweepConfig(RunConfig):
    """``kind = "sweep"``: the gap curve of a bench."""

    kind: Literal["sweep"]
    bench: BenchSource
    sweep: Sweep = Field(default_factory=Sweep)
    estimator: SweepEstimator = Field(default_factory=SweepEstimator)
    interval: Interval = Field(default_factory=Interval)


class Limits(Section):
    """``[limits]``: load angles; speed and acceleration of the motor; rests between strokes; length
    of the recording."""

    range_rad: AngleRange = (-0.5, 0.5)
    speed_rpm: Positive = 1500.0
    acceleration_rpm_per_s: Positive = 6000.0
    dwell_s: float = Field(default=0.15, ge=0.0)
    duration_s: float = Field(default=20.0, ge=1.0, le=600.0)


class PlanConfig(RunConfig):
    """``kind = "plan"``: motions ranked by the width of δ that they promise at ``gap_rad``."""

    kind: Literal["plan"]
    bench: BenchSource
    limits: Limits = Field(default_factory=Limits)
    gap_rad: Positive = 8e-4
    sampling_hz: float = Field(default=1000.0, ge=100.0)


def _resolve_row(row: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
    """Make the text of a file beside the configuration its absolute path."""
    return {
        key: str(resolve(value, info))
        if key != "name" and isinstance(value, str) and os.path.isfile(resolve(value, info))
        else value
        for key, value in row.items()
    }


class StudyConfig(RunConfig):
    """``kind = "study"``: an experiment from a file of its own, row by row.

    A row is a free table that the study itself validates; only its ``name`` is required here.
    """

    kind: Literal["study"]
    run: ClusterRun
    study: InputPath
    rows: Items[Annotated[dict[str, Any], AfterValidator(_resolve_row)]]

    @field_validator("rows")
    @classmethod
    def _named(cls, rows: tuple[dict[str, Any], ...]) -> tuple[dict[str, Any], ...]:
        names = [row.get("name") for row in rows]
        if not rows:
            refuse("A study needs rows.", expected="at least one [[rows]]")
        if not all(isinstance(name, str) and name.strip() for name in names):
            refuse("A row has no name.", found=names, expected="a name as text in every row")
        require_different(list(map(str, names)), "Two rows have the same name.")
        return rows


class IdentifiedRecording(SnapshotRecording):
    """As in a comparison, without ``known_gap``.

    A recording that is held out is predicted, not fitted.
    """

    use: Literal["fit", "hold_out"] = "fit"


_Parameters = Annotated[
    Literal["toleranced"] | tuple[str, ...],
    word_or_names("toleranced", "bench parameters", bench_parameter),
]
_Effects = Annotated[
    Literal["catalogue"] | tuple[str, ...],
    word_or_names("catalogue", "effects", effect_name, fewest=0),
]


class Identify(Section):
    """``[identify]``: what is fitted besides gap and start angles.

    ``parameters``: all that have a tolerance in the bench, or some of these by name. ``effects``:
    effects to fit, by name; ``"catalogue"`` adds those that the recordings show if the bench cannot
    explain them. ``gap_rad``: range of the gap's log-uniform prior.
    """

    parameters: _Parameters = "toleranced"
    effects: _Effects = ()
    gap_rad: GapBounds = (1e-4, 1e-2)


class IdentifyConfig(RecordedConfig):
    """``kind = "identify"``: each recording has a gap of its own."""

    kind: Literal["identify"]
    bench: InputPath
    identify: Identify = Field(default_factory=Identify)
    recordings: Annotated[Items[IdentifiedRecording], AfterValidator(differing_in("name"))]
    interval: Interval = Field(default_factory=Interval)

    def require_sound(self) -> None:
        if all(recording.use == "hold_out" for recording in self.recordings):
            refuse(
                "There is no recording to identify the bench from.",
                found="no recordings" if not self.recordings else 'use = "hold_out" in all',
                expected='[[recordings]] with use = "fit", best at two speeds in both directions',
            )


KINDS: Mapping[str, type[RunConfig]] = {
    "fit": FitConfig,
    "compare": CompareConfig,
    "sweep": SweepConfig,
    "plan": PlanConfig,
    "diagnose": DiagnoseConfig,
    "identify": IdentifyConfig,
    "study": StudyConfig,
    "fleet": FleetConfig,
}
"""Configuration model by kind."""

FILES: Mapping[str, str] = {
    "fit": "one recording to measure",
    "compare": "recordings to measure and compare",
    "simulate": "recordings to make on a bench",
    "sweep": "a bench to sweep over its gap",
    "plan": "a bench whose motions are ranked",
    "diagnose": "recordings, and the bench that should describe them",
    "identify": "recordings, and the data sheet from which a bench is identified",
    "study": "an experiment and its rows",
    "fleet": "an inventory of joints, and where their recordings are",
    "bench": "a virtual bench",
}
"""What a file of each kind holds, in words."""

RUNNABLE = tuple(kind for kind in FILES if kind != "bench")  # those that ``bayesbl run`` accepts
