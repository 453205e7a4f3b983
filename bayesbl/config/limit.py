"""A limit of the gap as a maker states it, and the gap δ that it means."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from bayesbl.config.sections import Positive, Section, refuse
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
    """``[joint] limit``: when to repair, as a maker states it; text such as "3 arcmin play" too.

    ``play`` is 2 δ. ``lost_motion`` is that between the torques ± ``at_torque_share`` of
    ``rated_torque_nm``, with the stiffness of the bench. mm are meant at the radius ``at_m``.
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

    @model_validator(mode="after")
    def _goes_together(self) -> Self:
        if (self.unit == "mm") != (self.at_m is not None):
            found = "no radius" if self.at_m is None else f"a radius with {self.unit}"
            refuse("A limit in mm, and no other, has a radius.", found=found, expected=EXAMPLES)
        if (self.of == "lost_motion") != (self.at_torque_share is not None):
            found = "no torque" if self.at_torque_share is None else f"a torque with {self.of}"
            refuse("Lost motion, and nothing else, has a torque.", found=found, expected=EXAMPLES)
        return self

    def __str__(self) -> str:
        radius = "" if self.at_m is None else f" at {self.at_m!r} m"
        share = self.at_torque_share
        torque = "" if share is None else f" at {float(f'{100.0 * share:.12g}')!r} %"
        return f"{self.value!r} {self.unit} {self.of}{radius}{torque}".replace(".0 ", " ")

    @property
    def name(self) -> str:
        """Unit and kind, as a measured value in them is told: ``arcmin of play``."""
        _, unit, kind = str(self).split(" ", 2)
        return f"{unit} of {kind.replace('_', ' ').replace('delta', 'δ')}"

    def windup_rad(self, torque_nm: float | None, stiffness_nm_per_rad: float | None) -> float:
        """What the joint gives way at the torque of a lost motion, both ways; 0 of other limits.

        Raises
        ------
        ConfigError
            Where rated torque or stiffness is missing.
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
        """The gap at this limit, rad.

        Raises
        ------
        ConfigError
            Where the joint gives way by more than the limit without any play.
        """
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
        """A gap in the unit and of the kind of this limit: the inverse of :meth:`delta_rad`."""
        return (delta_rad if self.of == "delta" else 2.0 * delta_rad + windup_rad) / self._rad

    @property
    def _rad(self) -> float:
        return conversion_factor("_rad", self.unit) if self.at_m is None else 1e-3 / self.at_m
