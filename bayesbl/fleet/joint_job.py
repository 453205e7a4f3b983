"""What one joint's measurement is made of: what it is given, what each part of it answers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date as Date
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from bayesbl.config.kinds import KINDS
from bayesbl.config.measurement import SnapshotConfig
from bayesbl.config.problems import problems_of
from bayesbl.config.sections import BASE_DIRECTORY
from bayesbl.errors import ConfigError
from bayesbl.fleet.inventory import Found, Joint
from bayesbl.measurement.measurement import Seeds
from bayesbl.recording.types import FloatArray

REFUSED, FAILED = "refused", "failed"
"""Outcomes beside those of a measurement: a recording that cannot be used; a bug met in it."""


@dataclass(frozen=True, slots=True)
class RecordingAnswer:
    """What measuring one recording by itself gave.

    Attributes
    ----------
    reason
        Why δ is withheld, or the recording refused; ``None`` where it is not.
    agrees
        Whether the recording may be one of its bench.
    gap_rad
        Draws of δ, shape (draw,), withheld or not; ``None`` without a curve.
    bench
        What is not known of the bench, in coordinates with a standard normal prior, shape
        (unknown, draw), paired with ``gap_rad``; ``None`` by the amplitude.
    amplitude_rpm
        Median, low and high.
    optimum
        Symbols and RMSE, by the amplitude.
    lasting
        Whether content and code alone decide it, so that it is the same whenever it is asked.
    """

    outcome: str
    reason: str | None
    notes: tuple[str, ...] = ()
    route: str = ""
    agrees: bool = True
    gap_rad: FloatArray | None = None
    bench: FloatArray | None = None
    amplitude_rpm: tuple[float, float, float] | None = None
    optimum: Mapping[str, float] | None = None
    lasting: bool = True

    @property
    def answers(self) -> bool:
        """Whether it gives δ."""
        return self.gap_rad is not None and self.reason is None


@dataclass(frozen=True, slots=True)
class JointAnswer:
    """How a joint wears since its last repair.

    Attributes
    ----------
    reason
        Why there is no rate; ``None`` where there is one.
    used
        Numbers of the recordings that the rate rests on.
    gap_rad
        Their gaps, paired by draw, shape (used, draw).
    rate_rad_per_year, rate_now_rad_per_year, years_to_limit
        Draws, shape (draw,), paired; empty where there are none.
    kind
        Of the law of each of these draws, its number in
        :data:`bayesbl.measurement.wear.KINDS`.
    jump_rad
        Mean jump of irregular wear of each of these draws.
    lasting
        As of a recording's answer.
    """

    reason: str | None
    route: str = ""
    used: tuple[int, ...] = ()
    gap_rad: FloatArray | None = None
    rate_rad_per_year: FloatArray | None = None
    rate_now_rad_per_year: FloatArray | None = None
    years_to_limit: FloatArray | None = None
    kind: FloatArray | None = None
    jump_rad: FloatArray | None = None
    probability_wear: float | None = None
    lasting: bool = True


@dataclass(frozen=True, slots=True)
class JointJob:
    """A joint with its recordings in order of time; it can be sent to another process.

    Attributes
    ----------
    sha256
        Of each recording's file.
    of_bench, of_curve
        SHA-256 of the files that the joint names.
    settings
        Sections of the configuration that all joints share.
    output
        Of the run, beside which swept benches and finished fits are kept.
    known
        Answers that are kept from an earlier run, by number of the recording.
    """

    joint: Joint
    recordings: tuple[Found, ...]
    sha256: tuple[str, ...]
    of_bench: str | None
    of_curve: str | None
    settings: Mapping[str, Any]
    seed: int
    output: str
    known: Mapping[int, RecordingAnswer] = field(default_factory=dict)

    @property
    def in_words(self) -> str:
        """Which joint it is."""
        return f"joint {self.joint.name}"

    @property
    def files(self) -> list[str]:
        """Of the joint, beside its recordings."""
        named = (self.joint.bench, None if self.of_curve is None else self.joint.curve)
        return [file for file in named if file is not None]

    @property
    def names(self) -> list[str]:
        """Of the recordings: the date, numbered where there are several of a day."""
        dates = [one.date for one in self.recordings]
        return [
            day if dates.count(day) == 1 else f"{day}-{dates[: n + 1].count(day)}"
            for n, day in enumerate(dates)
        ]

    @property
    def by_amplitude(self) -> bool:
        """Whether no recording is matched with a bench."""
        return self.joint.bench is None or self.settings["estimator"]["route"] == "amplitude"

    def problem(self) -> dict[str, Any]:
        """All that decides the answer: files by their content."""
        return {**self._of_all(), "limit_rad": self.joint.limit_rad} | {
            "in_service_since": self.joint.in_service_since,
            "repaired": self.joint.repaired,
            "recordings": [
                (one.date, sha, one.reference_speed_rpm)
                for one, sha in zip(self.recordings, self.sha256, strict=True)
            ],
            "wear": self.settings["wear"],
        }

    def problem_of(self, number: int, before: RecordingAnswer | None) -> dict[str, Any]:
        """The same of one recording; ``before``: what was measured before it."""
        optimum = None if before is None or not self.by_amplitude else before.optimum
        return {
            **self._of_all(),
            "recording": (self.names[number], self.sha256[number]),
            "reference_speed_rpm": self.recordings[number].reference_speed_rpm,
            "earlier": optimum,
        }

    def config(self, kind: str, numbers: Sequence[int], route: str | None = None) -> SnapshotConfig:
        """The configuration of a run over some of the recordings.

        Raises
        ------
        ConfigError
            In the words of that kind.
        """
        joint, model = self.joint, KINDS[kind]
        estimator = dict(self.settings["estimator"])
        if joint.bench is None:
            estimator |= {"route": "amplitude"}
        else:
            estimator |= {"bench": joint.bench, "route": route or estimator["route"]}
        curve = dict(self.settings["curve"]) | ({"source": joint.curve} if joint.curve else {})
        repaired = [n for n in numbers if joint.repaired and self._date(n) >= joint.repaired]
        tables: dict[str, Any] = {
            "schema": 1,
            "kind": kind,
            "run": {"seed": self.seed, "workers": 1, "output": self.output},
            "joint": {
                name: value
                for name, value in (
                    ("gear_ratio", joint.gear_ratio),
                    ("limit_rad", joint.limit_rad),
                )
                if value is not None
            },
            "recordings": [self._entry(n, repaired=n in repaired[:1]) for n in numbers],
            "estimator": estimator,
            "curve": curve,
            **{key: self.settings[key] for key in ("columns", "posterior", "interval")},
        }
        if kind == "compare":
            tables["wear"] = dict(self.settings["wear"])
            if joint.in_service_since is not None:
                tables["wear"]["in_service_since"] = Date.fromisoformat(joint.in_service_since)
        try:
            found = model.model_validate(tables, context={BASE_DIRECTORY: Path.cwd()})
        except ValidationError as error:
            first, *_ = problems_of(error, model, "")
            raise ConfigError(first.problem, **first.details()) from None
        assert isinstance(found, SnapshotConfig)
        return found

    def seeds(self, numbers: Sequence[int]) -> Seeds:
        """One for each recording by its content, so that no recording changes those of another."""
        whole = Seeds.spawn(self.seed, 0)
        own = tuple(
            np.random.SeedSequence([self.seed, int(self.sha256[n][:16], 16)]) for n in numbers
        )
        return replace(whole, recordings=own)

    def _of_all(self) -> dict[str, Any]:
        settings = {key: value for key, value in self.settings.items() if key != "wear"}
        joint = self.joint
        return {
            "joint": joint.name,
            "gear_ratio": joint.gear_ratio,
            "bench": self.of_bench,
            "curve": self.of_curve or joint.curve,
            "settings": settings,
            "seed": self.seed,
        }

    def _entry(self, number: int, repaired: bool) -> dict[str, Any]:
        one = self.recordings[number]
        entry = {"name": self.names[number], "file": one.file, "date": Date.fromisoformat(one.date)}
        if repaired:
            entry["repaired"] = True
        if one.reference_speed_rpm is not None:
            entry["reference_speed_rpm"] = one.reference_speed_rpm
        return entry

    def _date(self, number: int) -> str:
        return self.recordings[number].date
