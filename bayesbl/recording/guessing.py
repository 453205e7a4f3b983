"""Guess the channels and units of the columns of an unknown file, for a user to check.

Names decide first, then units that the file states, then the numbers: a plausible sampling rate, or
a speed that agrees with the position. Guesses are never used directly; they are written into a
configuration for the user to confirm.
"""

from __future__ import annotations

import math
import re
import shlex
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from types import MappingProxyType
from typing import Any

import numpy as np

from bayesbl.errors import RecordingError, shortened
from bayesbl.recording.array_table import ArrayTable
from bayesbl.recording.channels import (
    CHANNELS,
    LOAD_POSITION,
    MOTOR_CURRENT,
    MOTOR_POSITION,
    MOTOR_SPEED,
    MOTOR_TORQUE,
    REFERENCE_SPEED,
    TIME,
)
from bayesbl.recording.columns import COUNTED, StatedUnit, stamps_and_values, stated_unit
from bayesbl.recording.repairs import LONGEST_TICK_S, filled, unwrapped, without_strays
from bayesbl.recording.types import FloatArray
from bayesbl.units import (
    RPM_PER_RAD_PER_S,
    accepted_units,
    choice_of_units,
    conversion_factor,
    is_accepted,
)

_NAMES_OF: Mapping[str, str] = MappingProxyType(
    {
        TIME: "t time timestamp timestamps stamp zeit uhrzeit temps tempo tijd clock elapsed "
        "runtime ts sample samples",
        MOTOR_SPEED: "speed velocity vel velo omega w rpm erpm drehzahl n dq qd qvel",
        MOTOR_POSITION: "position pos angle theta phi encoder enc winkel lage geber q qpos aipos "
        "twist torsion deflection displacement messuhr",
        MOTOR_CURRENT: "current cur i iq strom amps macur courant corriente corrente ström",
        MOTOR_TORQUE: "torque tau trq moment drehmoment effort force kraft couple coppia",
    }
)
"""Words (in small letters) that files use for each channel."""

_TURNS_BY_MINUTE = "drehzahl"  # words that imply rpm
_USUAL = {TIME: "s", MOTOR_SPEED: "rpm"}

_REFERENCE = (
    "ref reference set setpoint cmd command target tgt desired des demand dem nominal soll sp goal "
    "vorgabe consigne consigna riferimento referencia vcmd pcmd tcmd icmd "
    "commanded requested request planned profile prescribed "
    "action"  # of a policy, to the joint
)
_SETPOINT = re.compile(r"[^\W\d]\*\s*$|指令|给定")
"""In names of setpoints: a star at the end (n*), and the Japanese and Chinese words."""

_LOAD = "load link joint output out arm l wheel pendulum secondary external abtrieb"
_MOTOR = "motor mot m antrieb"
_BESIDE = (
    "error err deviation difference diff lag residual abweichung fehler temperature temp "
    "supply bus battery dc freq frequency term "
    "limit limits lim max maximum min minimum peak rated nenn grenze grenzwert threshold "
    "feedforward ff vorsteuerung quality validity status numericid override "
    "ina"  # a monitor of the supply is called by its chip: INA219
)
"""Words that mark another quantity beside a channel of that name."""

_ELECTRICAL = "electrical electric elec el elektrisch elektrische"
"""Electrical speeds and angles are those of the motor times its pole pairs."""

_FILTERED = (
    "filtered filt smooth smoothed avg average averaged mean geglättet gefiltert gemittelt "
    "estimated estimate est observer model simulated virtual geschätzt"
)
_OF_WINDING, _BY_SYMBOL = (
    "d u v w alpha beta phase flux feldbildend reactive direct magnetising magnetizing "
    "input mains netz zwischenkreis brake brems",
    "id iu iv iw",
)
"""Words of currents of one winding, along the flux, of the supply or of the brake; id may also be
the number of a node."""

_NOT_DRIVING = "absolute abs betrag disturbance stör friction reib gravity cogging holding halte"
"""Words of currents and torques that do not drive the motor, or have lost their sign."""

_OF_DRIVE = (
    "active generating producing momentenbildend wirk quadrature axis joint drive servo value "
    "channel signal control controller shaft rotor side"
)
"""Words of a current or torque that is the motor's."""

_MEASURED = "act actual ist fb feedback measured meas real present"

_CLOCKS = "ms us ns msec usec millis micros"
_SIDES = f"{_REFERENCE} {_MOTOR} {_LOAD} state states"  # names of the groups of one joint's columns
_LOAD_TORQUE = "load torque"  # no channel: for ramps, the torque at the output replaces the motor's

_FEWEST_JOINTS = 3
"""Similar names with different numbers that make joints. Two may be both sides of one joint, except
in a message or for axes."""

_AXIS = re.compile(r"(?<![^\W_])(?:[aj]\d|ax[ie]s|achse|actual_qd?|qd?_act)", re.IGNORECASE)
"""Names of an axis or its joint, logged behind the gearbox: ``A1``, ``actual_qd_0``."""

_OF_JOINT = re.compile(
    r"(?<![^\W_])(?:(?i:ax[ie]s|achse|joint|gelenk|drive|antrieb)[\s_.]*(\d+|[A-EX-Z])"
    r"|(?i:motor|servo|[ajm])[\s_.]*(\d+))(?![^\W_])"
)
"""The number or letter of an axis in a name: ``Axis1 speed``, ``Drive_B.Current``."""

_TOKEN = re.compile(r"\d+|[^\W\d_]+")
_STEMS = frozenset(
    word
    for words in (
        *_NAMES_OF.values(),
        f"{_REFERENCE} {_LOAD} {_MOTOR} {_OF_WINDING} {_NOT_DRIVING} {_OF_DRIVE} {_MEASURED} wert",
    )
    for word in words.split()
    if len(word) > 2
)
"""Words that compounds are made of."""

_OF_CHANNELS = frozenset(word for words in _NAMES_OF.values() for word in words.split())
_NO_JOINT = _STEMS.union(
    _OF_CHANNELS,
    f"{_SIDES} {_FILTERED} {_ELECTRICAL} {_BESIDE} rms raw".split(),
)
"""Words that distinguish sides of one joint, or values of one channel."""

NO_UNIT = "no unit found: check it"  # reason for a unit that nothing in the file supports
_SI = {MOTOR_SPEED: "rad/s", MOTOR_POSITION: "rad", LOAD_POSITION: "rad", MOTOR_TORQUE: "N m"}
_TOPIC = re.compile(r"/\w+/|field\.")  # start of column names by PlotJuggler and ``rostopic``
_WITH_RATIO = 'enter the gear ratio with its unit, as "120 deg/s" or "120 deg" at a gear of 120'
UNKNOWN = "?"  # placeholder for an unknown unit or name; the configuration does not run with it
_USUAL_RATES_HZ = (10.0, 5e4)
_THESE_YEARS = (631152000.0, 4102444800.0)  # 1990 to 2100 in seconds since 1970

_STARTS: Mapping[str, tuple[float, ...]] = MappingProxyType(
    {
        "100 ns": (11644473600.0, 62135596800.0),
        "datenum": (86400.0 * 25569, 86400.0 * 719529),
        "86.4 ms": (86400.0 * 25569,),
    }
)
"""Seconds before 1970 at which the counts of Windows and .NET (ticks), Excel and MATLAB (days) and
WinCC (millionths of a day) begin. They are units only of times within these years."""

_UNITS_OF_TIME = ("s", "ms", "us", "ns", "min", *_STARTS)
_SHORTEST_S, _LONGEST_S = 0.5, 7200.0
_USUAL_SPEEDS_RPM = (30.0, 2e4)
_SWITCHED = (MOTOR_SPEED, MOTOR_POSITION, MOTOR_CURRENT, MOTOR_TORQUE, LOAD_POSITION, _LOAD_TORQUE)
"""Measured channels, which are never yes or no: ``torque_enabled`` is no torque."""

_TURNING, _DRIVEN = (MOTOR_SPEED, MOTOR_POSITION), (MOTOR_CURRENT, MOTOR_TORQUE)

_SIDES_ALIKE = 2.5  # largest ratio of the torques of both directions of ramps
_STANDSTILL_RPM = 1.0
_FASTEST_JOINT_RPM = 120.0  # 720 °/s: only small wrists are faster, and hardly any motor as slow
_TURNS_BACK = 1.5  # path over distance of a motor that moves to and fro
_FOLLOWS = 0.5  # share of a position's variance that another position of the same joint explains
_IS_INTEGRAL = 0.95  # the same share for a position and the integral of its speed
_AGREEMENT = 0.02  # relative difference within which speed and position belong together


@dataclass(frozen=True, slots=True)
class GuessedColumn:
    """A column, the channel it may be, and the reason.

    ``sure``: the file itself states the unit. ``needed``: nothing runs without the column.
    ``doubted``: the reason is a question about the channel.
    """

    channel: str
    name: str
    unit: str
    reason: str
    sure: bool
    needed: bool = True
    doubted: bool = False

    @property
    def is_open(self) -> bool:
        """Whether the user has to complete it."""
        return self.needed and self.unit == UNKNOWN

    @property
    def is_spare(self) -> bool:
        """Whether its unit is unknown and nothing needs it."""
        return not self.needed and self.unit == UNKNOWN


@dataclass(frozen=True, slots=True)
class Guess:
    """The recognised columns, time first, and the names of the others.

    ``route`` is ``torque_ramp`` if one side is held and a torque to and fro turns the other a
    little (the motor by its name if ``of_motor``), ``two_encoders`` if there are positions of motor
    and load and the motor reverses, else empty.
    """

    columns: tuple[GuessedColumn, ...]
    unused: tuple[str, ...]
    route: str = ""
    of_motor: bool = False

    @property
    def is_open(self) -> bool:
        """Whether the user has to complete anything."""
        return self.of_motor or any(column.is_open for column in self.columns)


@dataclass(frozen=True)  # without slots, for values that are read once
class _Named:
    """A column with what its name and the file say about it."""

    table: ArrayTable
    name: str
    words: frozenset[str]
    stated: StatedUnit

    def is_called(self, words: str) -> bool:
        """Whether its name has any of these words."""
        return not self.words.isdisjoint(words.split())

    def stated_for(self, channel: str) -> StatedUnit:
        """The stated unit, if this is the channel's column; for a topic of ROS by its channel."""
        stated = self.stated.of(channel)
        is_open = channel in _SI and stated.unit is None and stated.unknown is None
        return replace(stated, unit=_SI[channel]) if is_open and _TOPIC.match(self.name) else stated

    @cached_property
    def values(self) -> FloatArray:
        """Values, shape (n,), NaN if missing; all NaN for a column of text."""
        stamps = self.stamps
        if stamps is not None:
            return stamps
        try:
            values, _ = stamps_and_values(self.table, self.name)
        except RecordingError:
            return np.full(2, np.nan)
        return np.where(np.isfinite(values), values, np.nan)

    @cached_property
    def positions(self) -> FloatArray:
        """Values, shape (n,), unwrapped as for a recording."""
        without_strays(values := self.values.copy(), Counter[str](), self.name)
        for unit in _possible(MOTOR_POSITION, self) or ("rad",):
            size, repairs = conversion_factor(MOTOR_POSITION, unit), Counter[str]()
            whole = unwrapped(size * values, size, repairs, self.name)
            if repairs:
                return whole / size
        return values

    @property
    def rad(self) -> float | None:
        """Size in rad of the unit of angles that the file states."""
        unit = self.stated.of(MOTOR_POSITION).unit
        return None if unit is None else conversion_factor(MOTOR_POSITION, unit)

    @cached_property
    def stamps(self) -> FloatArray | None:
        """Seconds since the first date of a column of dates."""
        return self.table.timestamps(self.name)

    @property
    def has_dates(self) -> bool:
        """Whether it holds only dates."""
        try:
            return self.stamps is not None
        except RecordingError:
            return False

    @property
    def is_coarse(self) -> bool:
        """Whether several rows share each date, too far apart to tell when each row was sampled."""
        steps = np.diff(self.values) if self.has_dates and not self.increases else np.zeros(0)
        return bool(np.any(steps > 0.0) and np.median(steps[steps > 0.0]) > LONGEST_TICK_S)

    @property
    def is_of_axis(self) -> bool:
        """Whether its name says an axis and not the motor.

        The part before a point names a component of a drive (``axis0.encoder``); rpm is the
        motor's.
        """
        called = _AXIS.search(self.stated.bare.rpartition(".")[2]) is not None
        return called and self.stated.unit != "rpm" and not self.is_called(_MOTOR)

    @property
    def is_flag(self) -> bool:
        """Whether it holds only 0 and 1."""
        return bool(np.all(np.isin(self.values, (0.0, 1.0))))

    @property
    def is_constant(self) -> bool:
        """Whether it never changes, as a setpoint."""
        there = self.values[np.isfinite(self.values)]
        return bool(np.all(there == there[:1]))

    @property
    def increases(self) -> bool:
        """Whether it may be time."""
        there = self.values[np.isfinite(self.values)]
        return there.size > 2 and bool(np.all(np.diff(there) > 0.0))


@np.errstate(over="ignore", invalid="ignore")  # by numbers that are no measurements
def guess_columns(table: ArrayTable, joint: str | None = None) -> Guess:
    """Guess the channels of a file, or of one joint if its columns are called ``JOINT/NAME``.

    Raises RecordingError if no column can be time, if time or speed do not hold numbers, if there
    is no such joint, or if there are several and none was chosen.
    """
    named = _of_joint(table, joint)
    chosen = {channel: columns[0] for channel, columns in _candidates(named).items()}
    tied = {table.clocks.get(column.name) for c, column in chosen.items() if c != TIME} - {None}
    if len(tied) > 1:
        of_joint = [column.name for column in named if _channel(column) is not None]
        joined = table.at_shared_stamps(of_joint)
        if joined is not table:
            return _of_joined(guess_columns(joined, joint), joined, table)
        first = next(c for c in (MOTOR_SPEED, MOTOR_POSITION, *chosen) if c in chosen)
        clock_of_first = table.clocks.get(chosen[first].name)
        named = [c for c in named if table.clocks.get(c.name) in (None, clock_of_first)]
        chosen = {channel: columns[0] for channel, columns in _candidates(named).items()}
        tied = {clock_of_first} - {None}
    if len(tied) == 1:
        (clock,) = tied
        chosen[TIME] = next(column for column in named if column.name == clock)
    dates = next((c for c in named if c.has_dates and np.any(c.values != c.values[0])), None)
    if TIME not in chosen and dates is not None:
        chosen[TIME] = dates
    if TIME in chosen and not tied and chosen[TIME].name != TIME:
        coarse = chosen[TIME] if chosen[TIME].is_coarse else None
        clocks = [c for c in named if _channel(c) == TIME or (coarse and _as_long(c, coarse))]
        finer = (c for c in clocks if not c.stated.unknown and c.increases)
        chosen[TIME] = next(finer, chosen[TIME])
    paired = chosen | _pair_of_positions(named, chosen)
    ramps = _of_ramps(paired)
    if TIME not in chosen:
        rest = [column for column in named if column not in chosen.values()]
        increasing = next((column for column in rest if column.increases), None)
        numbered = table.numbered()
        if numbered is not table and (table.step_s is not None or (increasing is None and ramps)):
            # The file states its steps; torque over twist needs no time, but the order.
            guess = guess_columns(numbered, joint)
            return replace(guess, columns=tuple(c for c in guess.columns if c.channel != TIME))
        if increasing is None:
            raise RecordingError(
                "No column looks like time.",
                where="header",
                found=", ".join(f'"{name}"' for name in table.columns),
                expected=f'a column "{TIME}", or another name for it under [columns]; above even '
                'samples in a text, the line "Sampling time, 1 ms" will do',
            )
        chosen[TIME] = paired[TIME] = increasing
    both = not ramps and _is_of_two_encoders(paired)
    if ramps:
        chosen = {TIME: chosen[TIME], **ramps}
    elif both or MOTOR_SPEED not in chosen:
        chosen = paired
    chosen.pop(_LOAD_TORQUE, None)
    values = {
        channel: _series(column) if channel in (TIME, MOTOR_SPEED) else column.values
        for channel, column in chosen.items()
    }
    held = {channel: series for channel, series in values.items() if np.isfinite(series).any()}
    table.samples_of([chosen[channel].name for channel in held])
    units = _units(chosen, held)
    guesses = [_stated(channel, chosen[channel], units) for channel in held]
    if asked := _unlike_dates(chosen[TIME], named, guesses):
        guesses = _changed(guesses, TIME, unit=UNKNOWN, reason=asked, sure=True)
    if chosen.keys().isdisjoint((MOTOR_SPEED, MOTOR_POSITION)):
        guesses.append(GuessedColumn(MOTOR_POSITION, UNKNOWN, UNKNOWN, _no_motor(named), True))
    motors = [c for c in ramps.values() if c.is_called(_MOTOR) and c.name not in CHANNELS]
    if both:
        guesses = _of_sides(guesses, chosen)
    elif len(motors) == 1 and any(c.is_called(_LOAD) for c in ramps.values()):
        asked = 'enter its unit at the side of the position, as "0.01 N m" for N m at a gear of 100'
        guesses = _changed(guesses, MOTOR_TORQUE, unit=UNKNOWN, reason=asked, sure=True)
    elif not ramps:
        guesses = _of_motor(guesses, chosen, held)
    columns = _doubted(guesses, named)
    taken = {column.name for column in columns}
    order = [TIME, *CHANNELS]
    return Guess(
        tuple(sorted(columns, key=lambda c: order.index(c.channel))),
        tuple(name for name in table.columns if name and name not in taken),
        "torque_ramp" if ramps else "two_encoders" if both else "",
        bool(motors),
    )


def _no_motor(named: Sequence[_Named]) -> str:
    """The question for the motor's column; with the gear ratio, one of the load will do."""
    kinds = f"{_NAMES_OF[MOTOR_SPEED]} {_NAMES_OF[MOTOR_POSITION]}"
    behind = (c.name for c in named if c.is_called(_LOAD) and c.is_called(kinds))
    name = next(behind, None)
    asked = "enter the column of the motor's position and its unit; of its speed as motor_speed_rpm"
    return asked if name is None else f'{asked}; or "{name}", behind the gearbox: {_WITH_RATIO}'


def _of_joined(guess: Guess, joined: ArrayTable, table: ArrayTable) -> Guess:
    """The guess without spare columns of fewer values: the slowest column sets all times."""
    counts = {name: np.isfinite(joined.numbers([name])).sum() for name in joined.columns}
    needed = [counts[c.name] for c in guess.columns if c.needed and c.name in counts]
    columns = [c for c in guess.columns if c.needed or counts[c.name] >= min(needed)]
    taken = {column.name for column in columns}
    unused = tuple(name for name in table.columns if name not in taken)
    return replace(guess, columns=tuple(columns), unused=unused)


def _of_joint(table: ArrayTable, joint: str | None) -> list[_Named]:
    """Columns of the chosen joint or the only one; all columns if no name has a joint.

    The part before the last slash is the joint and a side of it (``motor/pos``); only the side
    tells what a column holds. Without slashes, joints may be numbered: ``q_0`` to ``q_6``.
    """
    bare = [stated_unit(table, name).bare for name in table.columns]
    groups = [name.rpartition("/")[0] for name in bare]
    groups = [g if _words(g) - _OF_CHANNELS else "" for g in groups]  # Drehzahl/Speed
    if not any(groups):
        groups = _names_of_joints(table)
    motors = {_without(group, _SIDES) for group in groups if _words(group) & {*_MOTOR.split()}}
    sides = [
        _SIDES if _without(group, _SIDES) in motors else f"{_REFERENCE} {_MOTOR} load"
        for group in groups
    ]
    names = [_without(group, of) for group, of in zip(groups, sides, strict=True)]
    inner = [_named(table, *of) for of in zip(table.columns, groups, sides, strict=True)]
    joints: dict[str, str] = {}
    for name, group, column in zip(names, groups, inner, strict=True):
        if name and _channel(column) in (MOTOR_SPEED, MOTOR_POSITION):
            joints.setdefault(name, group)
    known = shortened(", ".join(joints.values()), 200)
    first = next(iter(joints.values()), "")
    chosen = dict(zip(groups, names, strict=True)).get(first if joint is None else joint)
    if joint is not None and chosen not in joints:
        raise RecordingError(
            "There is no such joint.",
            where="--joint",
            found=shortened(joint),
            expected=known or "a joint with a column like joint_2/velocity",
        )
    if joint is None and len(joints) > 1:
        raise RecordingError(
            "The file holds several joints.",
            found=known,
            expected=f"one of them, e.g. --joint {shlex.quote(first)}",
        )
    if not joints:
        return [_named(table, name) for name in table.columns]
    above = f"{joints.get(chosen or '', '')}/"  # of a group that the joint is in may be its clock
    return [
        column
        for name, group, column in zip(names, groups, inner, strict=True)
        if name in ("", chosen) or above.startswith(f"{group}/")
    ]


def _without(group: str, sides: str) -> str:
    """The words of a group without those of its side; numbers at their ends stay."""
    parts = [re.sub(rf"^({sides.replace(' ', '|')})(?=\d*$)", "", p.lower()) for p in _split(group)]
    return " ".join(part for part in parts if part)


def _names_of_joints(table: ArrayTable) -> list[str]:
    """The number or word by which each name differs from similar ones; empty if they are too few.

    Words, and numbers of two names, are joints if a current or torque has one of them too: of
    "speed X", "speed Y" and "current Y", speed X is that of another joint.
    """
    tokens = [_TOKEN.findall(" ".join(_split(name))) for name in table.columns]
    channels = [_channel(_named(table, name)) for name in table.columns]
    places = [{(*t[:i], "", *t[i + 1 :]): word for i, word in enumerate(t)} for t in tokens]
    times = Counter(place for each in places for place in each)
    fewest = [
        _FEWEST_JOINTS - bool(_TOPIC.match(name) or "[" in name or _AXIS.search(name))
        for name in table.columns
    ]
    own = [
        next((word for place, word in each.items() if word.isdigit() and times[place] >= few), "")
        for few, each in zip(fewest, places, strict=True)
    ]
    turning = [p for p, c in zip(places, channels, strict=True) if c in _TURNING]
    times = Counter(place for each in turning for place in each)
    words = {w for each in turning for place, w in each.items() if times[place] > 1}
    words = {word for word in words if word.lower() not in _NO_JOINT}
    driven = [t for t, c in zip(tokens, channels, strict=True) if c in _DRIVEN]
    found = (_OF_JOINT.search(name) for name in table.columns)
    numbers = [next(filter(None, match.groups())) if match else "" for match in found]
    of_axes = {n for n, c in zip(numbers, channels, strict=True) if n and c in _SWITCHED}
    if not any(own) and len(of_axes) > 1:
        return [n if c in _SWITCHED else "" for n, c in zip(numbers, channels, strict=True)]
    joints = {*own} - {""} or (words if any(words.intersection(t) for t in driven) else set())
    return [
        of_name or next((word for word in t if word in joints and c in _SWITCHED), "")
        for of_name, t, c in zip(own, tokens, channels, strict=True)
    ]


def _of_ramps(chosen: Mapping[str, _Named]) -> dict[str, _Named]:
    """Position and torque of torque ramps, by channel; empty if there are none.

    The torque is about as large in both directions. It explains one of two positions better than
    the other position does: the held side follows the torque, and the side that turns lags behind.
    If there is a speed, the joint hardly turns.
    """
    sides = [chosen[c] for c in (MOTOR_POSITION, LOAD_POSITION) if c in chosen]
    torques = [chosen[c] for c in (MOTOR_TORQUE, _LOAD_TORQUE) if c in chosen]
    torques = [torque for torque in torques if _goes_both_ways(torque.values)]
    if not (sides and torques):
        return {}
    slopes = [_slope(torques[-1].values, side.values)[1] for side in sides]
    speed = chosen.get(MOTOR_SPEED)
    rivals = [_slope(sides[0].positions, other.positions)[1] for other in sides[1:]]
    if (rivals or speed) and max(slopes) <= max([_FOLLOWS, *rivals]):
        return {}
    if speed is not None:
        size = conversion_factor(MOTOR_SPEED, speed.stated.of(MOTOR_SPEED).unit or "rad/s")
        if size * np.nanmean(np.abs(speed.values)) >= _STANDSTILL_RPM:
            return {}
    turned = min(zip(slopes, sides, strict=True), key=lambda each: (each[0] < _FOLLOWS, each[0]))[1]
    of_motor = len(sides) == 2 and turned is sides[0]
    return {MOTOR_POSITION: turned, MOTOR_TORQUE: torques[0 if of_motor else -1]}


def _goes_both_ways(torque: FloatArray) -> bool:
    if not np.isfinite(torque).any():
        return False
    low, high = -float(np.nanmin(torque)), float(np.nanmax(torque))
    return 0.0 < max(low, high) <= _SIDES_ALIKE * min(low, high)


def _pair_of_positions(named: Sequence[_Named], chosen: Mapping[str, _Named]) -> dict[str, _Named]:
    """Motor and load among positions that their names do not distinguish: one follows the other.

    The motor is the one that is called so, or that turns further.
    """
    sides = (MOTOR_POSITION, LOAD_POSITION)
    there = [chosen[side] for side in sides if side in chosen]
    kinds = [*sides] if there else [None]  # motor, axis: names of the sides alone
    named = [c for c in named if not c.is_called(_BESIDE)]
    there = there or [c for c in named if c.is_called(_MOTOR) and _channel(c) is None][:1]
    if len(there) != 1:
        return {}
    others = [c for c in named if c is not there[0] and _channel(c) in kinds]
    follows = {_slope(there[0].positions, column.positions)[1]: column for column in others}
    if not follows or max(follows) < _FOLLOWS:
        return {}
    both = [there[0], follows[max(follows)]]
    called = _called(both)
    ways = [(c.rad or 1.0) * float(np.nanmax(c.positions) - np.nanmin(c.positions)) for c in both]
    if called[0] == called[1] and (both[0].rad is None) == (both[1].rad is None):
        if max(ways) < (1.0 + _AGREEMENT) * min(ways):
            return {}  # one position twice: nothing says that there is a gear between them
        called = [(False, way == max(ways)) for way in ways]
    return dict(zip(sides, both if called[0] >= called[1] else reversed(both), strict=True))


def _called(sides: Sequence[_Named]) -> list[tuple[bool, bool]]:
    """How much the names of two positions suggest the motor. Beside theta, q is the link."""
    by_words, by_symbols = (
        [(c.is_called(motor), not c.is_called(load)) for c in sides]
        for motor, load in ((_MOTOR, _LOAD), ("theta", "q"))
    )
    are_both = by_words[0] == by_words[1] and {*by_symbols} == {(True, True), (False, False)}
    return by_symbols if are_both else by_words


def _slope(along: FloatArray, values: FloatArray) -> tuple[float, float]:
    """Slope of values, shape (n,), over others, and the share of their variance that it explains.

    Both are 0 if one is constant, or they were not sampled together.
    """
    if along.size != values.size or not (np.isfinite(along).any() and np.isfinite(values).any()):
        return 0.0, 0.0
    along, values = filled(along), filled(values)
    if min(np.ptp(along), np.ptp(values)) == 0.0:
        return 0.0, 0.0
    (own, shared), (_, other) = np.cov(along, values)
    slope, explained = shared / own, shared * shared / (own * other)
    return (float(slope), float(explained)) if np.isfinite(explained) else (0.0, 0.0)


def _is_of_two_encoders(chosen: Mapping[str, _Named]) -> bool:
    """Whether there are both positions, and the motor moves to and fro."""
    if not {MOTOR_POSITION, LOAD_POSITION} <= chosen.keys():
        return False
    motor, load = (chosen[c].positions for c in (MOTOR_POSITION, LOAD_POSITION))
    if not any(_slope(motor, load)):
        return False
    motor = motor[np.isfinite(motor)]
    return float(np.abs(np.diff(motor)).sum()) > _TURNS_BACK * abs(float(motor[-1] - motor[0]))


def _changed(columns: Sequence[GuessedColumn], channel: str, **changes: Any) -> list[GuessedColumn]:
    """The columns with another guess for one channel."""
    return [replace(c, **changes) if c.channel == channel else c for c in columns]


def _of_sides(
    columns: Sequence[GuessedColumn], chosen: Mapping[str, _Named]
) -> list[GuessedColumn]:
    """Both positions are needed. A question is added if no name says which is the motor's, because
    these may be two joints, or two counters of different size."""
    sides = (MOTOR_POSITION, LOAD_POSITION)
    columns = [replace(c, needed=c.channel in (TIME, *sides)) for c in columns]
    if len({*_called([chosen[side] for side in sides])}) > 1:
        return columns
    reason = next(c.reason for c in columns if c.channel == MOTOR_POSITION)
    asked = f"perhaps the load's, since neither name tells which side is the motor's; {reason}"
    return _changed(columns, MOTOR_POSITION, reason=asked, doubted=True)


def _of_motor(
    columns: Sequence[GuessedColumn], chosen: Mapping[str, _Named], values: Mapping[str, FloatArray]
) -> list[GuessedColumn]:
    """The speed is needed, or else the position. That of an axis is asked for. So is what is slow
    for a motor (doubted in rpm), which may be of the joint, as in ROS; and a torque beside it."""
    main = MOTOR_SPEED if any(c.channel == MOTOR_SPEED for c in columns) else MOTOR_POSITION
    behind = f"by its name it is behind the gearbox: {_WITH_RATIO}; the unit alone if the motor's"
    asked = {c: behind for c in _TURNING if c in chosen and chosen[c].is_of_axis}
    sized = {
        column.channel: conversion_factor(column.channel, column.unit) * values[column.channel]
        for column in columns
        if column.unit != UNKNOWN and column.channel not in asked
    }
    needed = (main,) if main == MOTOR_SPEED else (main, TIME)
    rpm = np.inf
    if sized.keys() >= {*needed} and not chosen[main].is_called(_MOTOR):
        known = np.array([sized[channel] for channel in needed])
        known = known[:, np.isfinite(known).all(axis=0)]
        if main == MOTOR_SPEED:
            rpm = float(np.abs(known).mean())
        elif (ways := np.abs(np.diff(known)).sum(axis=1))[1]:
            rpm = RPM_PER_RAD_PER_S * float(ways[0] / ways[1])
    units = {column.channel: column.unit for column in columns if column.channel in sized}
    for channel in _TURNING if rpm < _FASTEST_JOINT_RPM else ():
        if channel in units:
            asked[channel] = (
                f"{rpm:.3g} rpm is slow for a motor: is it the joint's own, behind the gearbox? Of "
                f'a gear of 120 the unit here is "120 {units[channel]}", of the motor '
                f'"{units[channel]}"'
            )
    if asked and MOTOR_TORQUE in units and not chosen[MOTOR_TORQUE].is_called(_MOTOR):
        asked[MOTOR_TORQUE] = (
            'enter its unit at the motor: "0.01 N m" for N m behind a gear of 100, or "N m"'
        )
    columns = [replace(c, needed=c.channel in (TIME, main)) for c in columns]
    for channel, reason in asked.items():
        is_rpm = units.get(main if channel == MOTOR_TORQUE else channel) == "rpm"
        unit = units[channel] if is_rpm else UNKNOWN
        columns = _changed(columns, channel, unit=unit, reason=reason, sure=True, doubted=is_rpm)
    return columns


def _named(table: ArrayTable, name: str, group: str = "", sides: str = "") -> _Named:
    """A column with its words; ``group`` is the name before the slash, which may tell a side."""
    stated = stated_unit(table, name, name.removeprefix(f"{group}/"))
    if stated.unknown and table.timestamps(name) is not None:  # time [hh:mm:ss]
        stated = replace(stated, unknown=None)
    words = _words(stated.bare) | (_words(group) & {*sides.split()})
    unit = stated.unit or "rpm"
    turns = is_accepted(MOTOR_SPEED, unit) or is_accepted(MOTOR_POSITION, unit)
    if turns and words & {*_ELECTRICAL.split()}:
        stated = replace(stated, unit=None, unknown=f"electrical {stated.unit or ''}".strip())
    return _Named(table, name, words, stated)


def _split(text: str) -> list[str]:
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text)
    return [part for part in re.split(r"[\W_]+", spaced) if part]


def _words(text: str) -> frozenset[str]:
    """Words in small letters, without final numbers; compounds are split."""
    text = re.sub(r"\w+\s*=", " ", text)  # of a label, joint="left", the key is none
    text = re.sub(r"\|(\w+)\|", r"abs \1", text)
    words = (re.sub(r"\d+$", "", part.lower()) or part for part in _split(text))
    return frozenset(part for word in words for part in _parts_of(word))


def _parts_of(word: str) -> tuple[str, ...]:
    """Parts of a compound of known words (``drehzahlistwert``); otherwise the word itself."""
    if word in _STEMS:
        return (word,)
    if re.fullmatch("(q|w|theta|phi|omega)[ml]", word):  # a symbol and the index of its side
        return (word[:-1], word[-1])
    for end in range(len(word) - 2, 2, -1):
        for rest in (word[end:], word[end:].removeprefix("s")):  # antriebs|position
            if word[:end] in _STEMS and all(p in _STEMS for p in _parts_of(rest)):
                return (word[:end], *_parts_of(rest))
    return (word,)


def _channel(column: _Named) -> str | None:
    """The likely channel of a column, by a unit in brackets first, then by its words."""
    if column.name in (TIME, *CHANNELS):
        return column.name
    unit = column.stated.unit
    of_unit = [c for c in _NAMES_OF if unit and is_accepted(c, unit)]
    # A current is often called I_q, of which the letter q alone would be a joint's position.
    words = column.words - {"q"} if column.is_called("i") else column.words
    # What stands before a point is a part of the drive: axis0.pos_vel_mapper.pos_rel. A letter
    # beside a word is its unit or its axis: force_N.
    last = _words(re.split(r"\.(?!\d)", column.stated.bare)[-1]) & words
    by_words = (
        [c for c, named in _NAMES_OF.items() if not of.isdisjoint(named.split())]
        for among in (last, words)
        for of in (frozenset(word for word in among if len(word) > 1), among)
    )
    kinds = next(filter(None, by_words), [])
    kinds = [c for c in kinds if c in of_unit] or (
        kinds if kinds and (column.stated.ending or not of_unit) else of_unit
    )
    if not kinds:
        return TIME if column.is_called(_CLOCKS) else None
    kind = kinds[0]
    if kind != TIME and column.is_called(_BESIDE):
        return None
    is_named = column.is_called(_NAMES_OF[MOTOR_CURRENT])
    no_torque = column.is_called(_OF_WINDING) or (column.is_called(_BY_SYMBOL) and not is_named)
    if kind in _DRIVEN and (
        column.is_called(_NOT_DRIVING) or (kind == MOTOR_CURRENT and no_torque)
    ):
        return None
    if column.is_called(_REFERENCE) or _SETPOINT.search(column.stated.bare):
        return REFERENCE_SPEED if kind == MOTOR_SPEED else None
    if column.is_called(_LOAD) and not column.is_called(_MOTOR):
        return {MOTOR_POSITION: LOAD_POSITION, MOTOR_TORQUE: _LOAD_TORQUE, TIME: TIME}.get(kind)
    return kind


def _candidates(named: Sequence[_Named]) -> dict[str, list[_Named]]:
    """All columns that may be a channel, the likeliest first: named exactly, else the motor's.

    Filtered columns come last, as do single letters (``i``, ``n``), which may count samples.
    """
    candidates: dict[str, list[_Named]] = {}
    for column in sorted(named, key=_rank):
        channel = _channel(column)
        if channel is None:
            continue
        if channel != TIME and _rank(column)[-1] and np.all(np.diff(column.values) == 1.0):
            continue  # it counts the samples: 0, 1, 2, …
        if channel in _SWITCHED and column.name not in (TIME, *CHANNELS) and column.is_flag:
            continue
        candidates.setdefault(channel, []).append(column)
    return candidates


def _rank(column: _Named) -> tuple[bool, ...]:
    return (
        column.name not in (TIME, *CHANNELS),
        bool(column.words & COUNTED),
        column.is_called(f"{_FILTERED} {_ELECTRICAL}"),
        column.stated.unknown is not None,
        not column.is_called(_MOTOR),
        column.is_constant and _channel(column) == MOTOR_SPEED,
        not column.is_called(_MEASURED),
        max(map(len, column.words), default=0) == 1,
    )


def _doubted(
    columns: Sequence[GuessedColumn], named: Sequence[_Named]
) -> tuple[GuessedColumn, ...]:
    """A question for a channel of which no name says that another column is less likely, and for a
    current or torque whose name has a word more, as ``PSU current`` has.

    Words that the speed or the position shares are the joint's name.
    """
    words = {c.name: _words(c.stated.bare.rpartition(".")[2].rpartition("/")[2]) for c in named}
    of_joint = {w for c in columns if c.channel in _TURNING for w in words.get(c.name, ())}
    known = (_NO_JOINT - {"rms"}) | of_joint | {*_OF_DRIVE.split()}  # rms may have lost its sign
    candidates, taken = _candidates(named), {column.name for column in columns}
    doubted = []
    for column in columns:
        ranked = candidates.get(column.channel, ())
        own = [_rank(c) for c in ranked if c.name == column.name]
        alike = [c.name for c in ranked if c.name not in taken and _rank(c) in own]
        unknown = {
            w for w in words.get(column.name, frozenset()) - known if w.isalpha() and len(w) > 2
        }
        asked = []
        if alike and column.channel in _SWITCHED:
            asked.append(f'no name says why it should not be "{alike[0]}"')
        if unknown and column.channel in _DRIVEN and column.name != column.channel:
            asked.append(f'"{min(unknown)}" in its name may mean another')
        reason = "; ".join([*asked, column.reason])
        doubted.append(replace(column, reason=reason, doubted=column.doubted or bool(asked)))
    return tuple(doubted)


def _stated(
    channel: str, column: _Named, suggested: Mapping[str, tuple[str, str]] | None = None
) -> GuessedColumn:
    """The guess with the unit that the file states, else with the one that the numbers suggest."""
    stated, units = column.stated_for(channel), choice_of_units(channel)
    unit, sure = stated.unit or UNKNOWN, bool(stated.unknown or stated.unit)
    # A share, a count or a number that was scaled looks like any other.
    reason = f"enter its unit: {_readings(channel, column)}{units}"
    if stated.unknown:
        unit = UNKNOWN
        reason = f'enter its unit, as the file says "{shortened(stated.unknown)}": {units}'
    elif stated.unit and column.stated.unit:
        reason = "the name says so" if column.name == channel else "stated in the file"
    elif stated.unit:
        reason = "ROS logs in SI units (REP 103)"
    elif suggested and channel in suggested:
        unit, reason = suggested[channel]
    elif channel == TIME or (channel == MOTOR_SPEED and column.is_called(_TURNS_BY_MINUTE)):
        unit, reason = _USUAL[channel], NO_UNIT
    return GuessedColumn(channel, column.name, unit, reason, sure)


def _readings(channel: str, column: _Named) -> str:
    """What a speed would be in each unit in which it is plausible for a motor."""
    if channel != MOTOR_SPEED or not np.isfinite(column.values).any():
        return ""
    mean = float(np.nanmean(np.abs(column.values)))
    factors = [(unit, conversion_factor(channel, unit)) for unit in accepted_units(channel)]
    sizes = {mean * factor: unit for unit, factor in reversed(factors)}
    low, high = _USUAL_SPEEDS_RPM
    readings = [f"{rpm:.0f} rpm if in {unit}" for rpm, unit in sizes.items() if low <= rpm <= high]
    return f"its mean is {', '.join(readings)}; " if readings else ""


def _units(
    chosen: Mapping[str, _Named], values: Mapping[str, FloatArray]
) -> dict[str, tuple[str, str]]:
    """Channel to (unit, reason), as far as the numbers show it."""
    units: dict[str, tuple[str, str]] = {}
    time = _time_unit(chosen[TIME])
    if time is not None:
        units[TIME] = time
    unit = time[0] if time else _stated(TIME, chosen[TIME]).unit
    if MOTOR_SPEED not in values or unit == UNKNOWN:
        return units
    if MOTOR_POSITION in values:
        seconds = conversion_factor(TIME, unit) * values[TIME]
        units |= _of_position(chosen, unit, seconds, values[MOTOR_SPEED])
    speed = _stated(MOTOR_SPEED, chosen[MOTOR_SPEED], units).unit
    return (
        units if speed == UNKNOWN else units | {REFERENCE_SPEED: (speed, "as the speed: check it")}
    )


def _of_position(
    chosen: Mapping[str, _Named], time: str, seconds: FloatArray, speed: FloatArray
) -> dict[str, tuple[str, str]]:
    """Units in which the position's derivative is the speed; both have shape (n,).

    With units that the file states, the guessed unit of time may be wrong by a power of ten.
    Several pairs that agree equally are a question: turns and turns per second do if rad and rad/s
    do.
    """
    known = np.isfinite(seconds) & np.isfinite(speed)
    at, along = seconds[known], np.full(seconds.shape, np.nan)
    means = 0.5 * (speed[known][1:] + speed[known][:-1])
    along[known] = np.concatenate([[0.0], np.cumsum(means * np.diff(at))])
    rate, explained = _slope(along, chosen[MOTOR_POSITION].positions)
    mean = float(np.mean(np.abs(speed[known])))
    units = list(product(*(_possible(c, chosen[c]) for c in (MOTOR_SPEED, MOTOR_POSITION))))
    by_span: dict[tuple[float, float], tuple[str, str]] = {}
    for mine, theirs in units:
        size = conversion_factor(MOTOR_SPEED, mine)
        angle = conversion_factor(MOTOR_POSITION, theirs)
        longer = abs(rate) * angle * RPM_PER_RAD_PER_S / size
        if abs(longer - 1.0) <= _AGREEMENT:
            by_span.setdefault((size, angle), (mine, theirs))
        elif len(units) == 1 and time != "datetime" and explained >= _IS_INTEGRAL:
            tens = 10.0 ** round(math.log10(longer))
            if abs(longer / tens - 1.0) <= _AGREEMENT:
                asked = f'enter its unit: speed and position agree in "{tens:g} {time}", not {time}'
                return {TIME: (UNKNOWN, asked)}
    pairs = [pair for (size, _), pair in by_span.items() if size * mean <= _USUAL_SPEEDS_RPM[1]]
    if explained < _IS_INTEGRAL or not pairs:
        asked = "enter its unit, as it is the position's derivative in none: "
        return {MOTOR_SPEED: (UNKNOWN, asked + choice_of_units(MOTOR_SPEED))} if units else {}
    if len(pairs) > 1:
        agreeing = " or ".join(f"{speed_unit} and {angle}" for speed_unit, angle in pairs)
        readings = _readings(MOTOR_SPEED, chosen[MOTOR_SPEED])
        asked = f"enter its unit: {readings}speed and position agree in {agreeing}"
        return dict.fromkeys((MOTOR_SPEED, MOTOR_POSITION), (UNKNOWN, asked))
    sides, reason = (MOTOR_SPEED, MOTOR_POSITION), "speed and position then agree"
    return {channel: (unit, reason) for channel, unit in zip(sides, pairs[0], strict=True)}


def _possible(channel: str, column: _Named) -> Sequence[str]:
    stated = column.stated_for(channel)
    if stated.unknown:
        return ()
    return (stated.unit,) if stated.unit else accepted_units(channel)


def _time_unit(column: _Named) -> tuple[str, str] | None:
    """The unit in which stamps are dates of these years, or have a usual sampling rate."""
    if column.stamps is not None:
        return "datetime", "holds dates"
    if _stated(TIME, column).sure:
        return None
    there = column.values[np.isfinite(column.values)]
    steps = np.diff(there)
    steps = -steps if np.all(steps < 0.0) else steps  # the newest first
    if np.all((there > 1990e10) & (there < 2100e10) & (there % 100 < 60) & (there % 1e6 < 24e4)):
        return UNKNOWN, f"write its dates with marks: 2026-03-14T08:12:33, not {there[0]:.0f}"
    of_name = _channel(column) == TIME
    if np.all(steps == 1.0) and not of_name:
        return UNKNOWN, 'it counts the samples: enter what lies between two of them, as "4 ms"'
    step = float(np.median(steps)) or float(np.mean(steps))  # a coarse clock stands still
    usual: dict[str, float] = {}
    for unit in ("s", "ms", "us", "ns", *_STARTS):
        factor = conversion_factor(TIME, unit)
        rate = 1.0 / (step * factor) if step > 0.0 else 0.0
        if not _USUAL_RATES_HZ[0] <= rate <= _USUAL_RATES_HZ[1]:
            continue
        begins = float(there[0]) * factor
        starts = _STARTS.get(unit, (0.0,))
        if any(_THESE_YEARS[0] <= begins - start <= _THESE_YEARS[1] for start in starts):
            return unit, f"its years, and a sampling rate of {rate:.4g} Hz"
        if unit not in _STARTS and _SHORTEST_S <= factor * step * steps.size <= _LONGEST_S:
            usual[unit] = rate
    readings = [f"{rate:.4g} Hz in {unit}" for unit, rate in usual.items()]
    if len(usual) > 1 or (usual and not of_name):
        asked = "no name says that it is the time; enter its unit if it is"
        asked = "enter its unit" if of_name else asked
        return UNKNOWN, f"{asked}: a sampling rate of {' or '.join(readings)}"
    if not usual and 0.0 < step < 1.0 / _USUAL_RATES_HZ[1]:
        units = choice_of_units(TIME)
        return UNKNOWN, f"enter its unit: in s it would be sampled at {1.0 / step:.4g} Hz; {units}"
    return next(((unit, f"a sampling rate of {rate:.4g} Hz") for unit, rate in usual.items()), None)


def _as_long(clock: _Named, dates: _Named, units: Iterable[str] = ()) -> list[str]:
    """Units in which a numeric time lasts as long as dates do, to within one of their steps."""
    if clock.stamps is not None:
        return []
    steps, own = (np.diff(c.values[np.isfinite(c.values)]) for c in (dates, clock))
    long_s = float(steps.sum())
    most = float(steps.max(initial=0.0)) + _AGREEMENT * long_s
    sizes = {u: conversion_factor(TIME, u) * float(own.sum()) for u in (*units, *_UNITS_OF_TIME)}
    return [u for u, size in sizes.items() if long_s > 0.0 and abs(size - long_s) <= most]


def _unlike_dates(clock: _Named, beside: Sequence[_Named], guesses: Sequence[GuessedColumn]) -> str:
    """A question if a time is longer or shorter than the dates beside it, or has no unit."""
    unit = next(c.unit for c in guesses if c.channel == TIME)
    dates = next((c for c in beside if c.has_dates), None)
    if dates is None or clock.stamps is not None:
        return ""
    known = () if unit == UNKNOWN else (unit,)
    agree = _as_long(clock, dates, known)
    own, long_s = (float(np.nanmax(c.values) - np.nanmin(c.values)) for c in (clock, dates))
    if long_s <= 0.0 or unit in agree or not (known or agree):
        return ""
    lasts = "".join(f"{conversion_factor(TIME, u) * own:.3g} s in {u}, but " for u in known)
    lasts += f'{long_s:.3g} s by the dates in "{dates.name}"'
    fitting = " or ".join(f'"{u}"' for u in agree) or choice_of_units(TIME)
    return f"enter its unit: it lasts {lasts}; write {fitting}"


def _series(column: _Named) -> FloatArray:
    """Values of a column that every recording needs, (n,); refused with fewer than two."""
    if (count := int(np.isfinite(column.values).sum())) < 2:
        if column.stamps is None:
            stamps_and_values(column.table, column.name)  # says where a text is
        raise RecordingError(
            "This column is not a series of numbers.",
            where=f'column "{column.name}"',
            found=f"{count} finite numbers in {column.values.size} samples",
            expected="a finite number in every sample",
        )
    return column.values
