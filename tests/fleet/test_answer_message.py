"""What comes from a network is a row that watch can have written, or is refused with a reason."""

from __future__ import annotations

import json

import numpy as np
import pytest

from bayesbl.config.sections import Interval
from bayesbl.fleet.broker import LARGEST_MESSAGE_BYTES, decoded_answer, encoded_answer
from bayesbl.fleet.inventory import Joint
from bayesbl.fleet.measured_joint import RecordingAnswer
from bayesbl.fleet.plant_tables import recording_row

JOINT = Joint(joint="R1-J2", limit_rad=1.2e-3)
WHICH = {"joint": "R1-J2", "date": "2025-01-01", "file": "a.csv", "sha256": "a" * 64}
GAP = np.random.default_rng(1).normal(1e-3, 1e-5, 500)


def row_of(answer: RecordingAnswer) -> dict[str, object]:
    return recording_row(answer, JOINT, None, Interval(level=0.9, kind="hdi")) | WHICH


MEASURED = row_of(RecordingAnswer("usable", None, ("ä note",), "direct", True, GAP))


@pytest.mark.parametrize(
    "row",
    [
        MEASURED,
        row_of(RecordingAnswer("withheld", "Too noisy.", gap_rad=GAP)),
        row_of(RecordingAnswer("no_curve", "No curve.", amplitude_rpm=(20.0, 19.0, 21.0))),
        row_of(RecordingAnswer("withheld", "Too weak.", amplitude_rpm=(0.1, -0.2, 0.4))),
        row_of(RecordingAnswer("refused", "No file.")) | {"sha256": None, "date": "spring"},
    ],
)
def test_a_row_comes_as_it_went(row):
    assert decoded_answer(encoded_answer(row, "d1")) == row | {"device": "d1"}


def with_number(number: bytes) -> bytes:
    whole = encoded_answer(MEASURED | {"delta_rad_sd": 0.125}, "d1")
    assert whole.count(b"0.125,") == 1
    return whole.replace(b"0.125", number)


def changed(**values):
    return encoded_answer(MEASURED | values, "d1")


@pytest.mark.parametrize(
    ("message", "told"),
    [
        (b"\xff", "not JSON"),
        (b"[" * 50_000, "not JSON"),
        (b"[]", "schema 2"),
        (b'{"schema": 1, "recording": {}}', "schema 2"),
        (b'{"schema": 2}', "which device"),
        (b'{"schema": 2, "device": "../x", "recording": {}}', "which device"),
        (b'{"schema": 2, "device": "d1"}', "other parts"),
        (b'{"schema": 2, "device": "d1", "recording": []}', "valid dictionary"),
        (b'{"schema": 2, "recording": {"delta_rad_median": NaN}}', "NaN is no number"),
        (with_number(b"1e999"), "delta_rad_sd"),
        (with_number(b"1" + b"0" * 400), "delta_rad_sd"),
        (with_number(b"1" + b"0" * 4000), "delta_rad_sd"),
        (b'{"schema": 2, "device": "d1", "recording": {"joint": "\\ud800"}}', "joint.*unicode"),
        (b'{"schema": 2, "device": "d1", "x": 1' + b"0" * 5000 + b"}", "digits"),
        (changed(device="d2"), "device: Extra"),
        (b" " * (LARGEST_MESSAGE_BYTES + 1), "bytes, more than"),
        (changed(joint="../../etc"), "joint: .*pattern"),
        (changed(joint=""), "joint: "),
        (changed(joint=3), "joint: .*string"),
        (changed(file="x" * 20_000), "file: .*at most"),
        (changed(date="2025-13-01"), "date: "),
        (changed(sha256="A" * 64), "sha256: "),
        (changed(sha256=None), "sha256: "),
        (changed(outcome="fine"), "outcome: "),
        (changed(used=1), "used: .*boolean"),
        (changed(more=1), "more: Extra"),
        (changed(delta_rad_median=-1e-3), "delta_rad_median: .*0"),
        (changed(delta_rad_median=True), "delta_rad_median: .*number"),
        (changed(delta_rad_low=2e-3), "not in order"),
        (changed(delta_rad_q05=None), "no delta_rad_q05"),
        (changed(amplitude_rpm_low=1.0), "not complete"),
        (changed(probability_above_limit=1.5), "probability_above_limit: .*1"),
        (changed(reason="No."), "beside the reason"),
        (changed(outcome="withheld"), "outcome says"),
    ],
)
def test_anything_else_is_refused_with_a_reason(message, told):
    with pytest.raises(ValueError, match=told):
        decoded_answer(message)


def test_what_is_not_finite_is_left_out():
    row = row_of(RecordingAnswer("withheld", "Odd.", amplitude_rpm=(np.nan, 1.0, np.inf)))
    assert "amplitude_rpm_median" not in json.loads(encoded_answer(row, "d1"))["recording"]


def test_a_message_is_small():
    assert len(encoded_answer(MEASURED, "d" * 40)) < 1500
    assert json.loads(encoded_answer(MEASURED, "d1"))["schema"] == 2
