"""``kind = "fleet"``: many joints, their dated recordings, and how all of them are measured."""

from __future__ import annotations

import re
from datetime import date as Date
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, ValidationInfo, model_validator

from bayesbl.config.measurement import Curve, Noise, Posterior, WearOverDates
from bayesbl.config.sections import (
    ClusterRun,
    GapBoundsFromZero,
    InputPath,
    Interval,
    Items,
    Model,
    RecordedConfig,
    Section,
    refuse,
    require_different,
    resolve,
)

_PLACES = {"{joint}", "{date}"}


def _source_of_recordings(value: object, info: ValidationInfo) -> str:
    """The pattern or the table as a whole path."""
    if not isinstance(value, str) or not value.strip() or "\0" in value:
        refuse("This is neither a pattern nor a table of recordings.", expected="text")
    places = set(re.findall(r"\{[^{}]*\}", value))
    if re.match(r"[a-z][a-z0-9+.-]+://", value):
        refuse("Recordings are files.", expected="a folder that they are copied to")
    if places == _PLACES:
        return str(resolve(value, info))
    if places or "*" in value:
        refuse(
            "This pattern does not say which joint and which date a file is of.",
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
    """``[fleet]``: inventory, recordings, and how joints share information.

    ``recordings`` is a pattern with ``{joint}`` and ``{date}``, or a table with the columns
    ``joint``, ``date`` and ``file``. ``pool_by`` is the column of the inventory whose joints wear
    alike; without it every joint counts by itself. ``covariates`` are columns of numbers, such as
    a load, that the rates of joints of one type may depend on.
    """

    joints: Annotated[InputPath, BeforeValidator(_table)]
    recordings: Annotated[str, BeforeValidator(_source_of_recordings)]
    pool_by: str | None = None
    covariates: Items[str] = ()
    decide_before: Date | None = None

    @model_validator(mode="after")
    def _covariates_of_a_type(self) -> Self:
        if self.covariates and self.pool_by is None:
            refuse(
                "What rates depend on is learned from joints of one type.",
                found="covariates without pool_by",
                expected='pool_by as well, e.g. "gearbox"',
                at=("covariates",),
            )
        require_different(self.covariates, "Two covariates are the same.")
        return self

    @property
    def is_pattern(self) -> bool:
        """Whether the recordings are found by a pattern."""
        return "{joint}" in self.recordings


class FleetEstimator(Section):
    """``[estimator]`` of a fleet: that of a comparison; the inventory has bench and curve.

    ``route`` holds for joints with a bench; the others are measured by the amplitude.
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

    @model_validator(mode="after")
    def _of_joints_stands_in_the_inventory(self) -> Self:
        for found, what, at in (
            (self.curve.source, "A curve", ("curve", "source")),
            (self.wear.in_service_since, "in_service_since", ("wear", "in_service_since")),
        ):
            if found is not None:
                refuse(
                    f"{what} belongs to a joint, not to a fleet.",
                    found=found,
                    expected=f"a column {at[-1].replace('source', 'curve')} of the inventory",
                    at=at,
                )
        return self
