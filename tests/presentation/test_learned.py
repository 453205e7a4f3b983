"""What was learned is told, stored and drawn: a torque, and an error of the encoder."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bayesbl.bench.learned import LearnedTerm
from bayesbl.diagnosis.diagnosis import Diagnosis, LearnedAnswer
from bayesbl.diagnosis.disagreement import ComparedPiece
from bayesbl.diagnosis.groups import answer_of, diagnosis_tree
from bayesbl.presentation.diagnosis import headline, learned
from bayesbl.presentation.figures.diagnosis import learned_course

TURN = 2.0 * math.pi
TORQUE = LearnedTerm("motor", "motor_angle", TURN, 0.0, (0.02, 0.0), (0.01, 0.03))
ERROR = LearnedTerm(
    "encoder", "motor_angle", TURN, 0.0, (3e-4, 0.0, 0.0, 1e-4), (0.0, 2e-4, 0.0, 0.0)
)


def diagnosis(term: LearnedTerm, *alike: LearnedTerm) -> Diagnosis:
    x = np.linspace(0.0, TURN, 50)
    noise = np.random.default_rng(1).standard_normal((4, 300))
    piece = ComparedPiece.of("forward", "motor_speed_rpm", "used", *noise, rotation=100)
    told = LearnedAnswer(term, x, np.full(x.size, 1e-5), alike)
    return Diagnosis(
        "unexplained",
        (),
        (),
        (),
        (piece,),
        gap_withheld="No gap is given." if alike else "",
        learned=told,
    )


@pytest.mark.parametrize(
    ("term", "told"),
    [
        (TORQUE, "a torque at the motor over the motor angle, orders 1 to 2"),
        (ERROR, "an error of the motor's encoder over the motor angle, orders 1"),
    ],
    ids=["torque", "encoder"],
)
def test_it_is_told_by_what_it_depends_on_and_drawn(term: LearnedTerm, told: str) -> None:
    tree = diagnosis_tree(diagnosis(term), 0.9, "equal_tailed")
    summary = answer_of(diagnosis(term), 0.9, "equal_tailed")
    assert term.block in summary
    assert told in headline(summary)
    assert learned_course.applies(tree)
    (axes,) = learned_course(tree).axes
    (line,) = [line for line in axes.lines if len(line.get_xdata()) > 2]
    assert np.asarray(line.get_xdata())[-1] == pytest.approx(1.0), "turns of the motor"
    scale = 1e3 if term is ERROR else 1.0
    shown = np.asarray(line.get_ydata())
    assert np.max(np.abs(shown - shown.mean())) == pytest.approx(
        scale * diagnosis(term).learned.amplitude
    )


def test_what_it_is_not_told_from_is_said() -> None:
    sentences = " ".join(learned(answer_of(diagnosis(ERROR, TORQUE), 0.9, "equal_tailed")))
    assert "cannot be distinguished from a torque at the motor" in sentences
    assert " mrad." in sentences
    assert "No gap is given." in sentences
