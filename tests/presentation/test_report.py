"""Laws of the terminal: the answer first, nothing certain, nothing wider than the terminal."""

from __future__ import annotations

import copy
import io
import json
import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from synthetic_ringing import QUICK

from bayesbl.bench.effects import EFFECTS
from bayesbl.bench.parameters import BENCH_PARAMETERS
from bayesbl.config.loading import load_config
from bayesbl.curve.gap_curve import published_curve
from bayesbl.errors import ConfigError, RecordingError
from bayesbl.measurement.gap_by_curve import MeasuredRinging, gaps
from bayesbl.measurement.routes import measure
from bayesbl.presentation import answer, estimates, words
from bayesbl.presentation.console import print_result, print_summary
from bayesbl.presentation.diagnosis import UNTOLD_SHARE, removed
from bayesbl.presentation.identification import compared
from bayesbl.presentation.study import study_table
from bayesbl.presentation.terminal import error, filled, print_table, progress, wrapped
from bayesbl.ringing.symbols import SYMBOLS
from bayesbl.ringing.waveform import pulse_train
from bayesbl.sentences import UNSEEN_WITHOUT_CURRENT, sentence
from bayesbl.units import number, quantity_and_unit

WARNING = "The published curve belongs to the paper's bench; δ can be off by several percent."


class Screen(io.StringIO):
    """A terminal's file."""

    def isatty(self):
        return True


def console(*, terminal=False, width=80):
    return Console(
        file=Screen() if terminal else io.StringIO(),
        force_terminal=terminal,
        width=width,
        highlight=False,
        markup=False,
    )


def between(low, high, kind="equal_tailed"):
    return {"median": 0.5 * (low + high), "low": low, "high": high, "level": 0.9, "kind": kind}


def check(*sentences, blind_spots=()):
    """What a check found."""
    return {
        "agrees": not sentences,
        "items": [],
        "could_be": [],
        "findings": [because(text, code="quantity_changed") for text in sentences],
        "blind_spots": list(blind_spots),
    }


def because(*sentences, code="sampling"):
    """Sentences as the one reason of a summary."""
    if not sentences:
        return None
    return {"code": code, "text": " ".join(sentences)}


def part(low=6.85e-4, high=7.31e-4, reasons=()):
    """A snapshot's part of a summary; with reasons it is withheld."""
    answer = {
        "route": "amplitude",
        "curve": "results/sweep/result.nc",
        "delta_rad": None if reasons else between(low, high),
        "delta_upper_bound_rad": None,
        "amplitude_rpm": between(30.8, 32.3),
        "parameters": {
            "amplitude_rpm": between(30.8, 32.3),
            "decay_rate_per_s": between(19.0, 20.0),
            "angular_frequency_rad_per_s": between(70.0, 71.0),
        },
        "optimum": {"decay_rate_per_s": 19.5, "angular_frequency_rad_per_s": 70.5},
        "rmse_rpm": 1.82,
        "relative_rmse": 0.3,
        "rotations": 5.0,
        "noise": {
            "kind": "ar",
            "order": 1,
            "sd_rpm": 1.51,
            "coefficients": [0.6],
            "degrees_of_freedom": None,
            "student_t_evidence": -9.8,
            "differentiated": False,
            "repeating_rounding_sd_rpm": 0.0,
        },
        "budget": {"noise": 0.97, "start_angle": 0.0, "rounding": 0.03},
        "diagnostics": {
            "r_hat": 1.001,
            "ess_bulk": 3000.0,
            "outcome": "withheld" if reasons else "converged",
            "reasons": [{**because(text), "withholds": True} for text in reasons],
        },
        "limit_rad": 1.2e-3,
        "probability_above_limit": None if reasons else 0.0,
        "reason": because(*reasons),
        "model_check": check(),
    }
    return {**answer, "routes": {"amplitude": answer}}


def without_a_curve(snapshot):
    """The same, of the ringing alone."""
    alone = {**snapshot, "curve": None, "delta_rad": None}
    del alone["routes"]
    return {**alone, "routes": {"amplitude": alone}}


def ringing_alone(**changed):
    """A summary of compared snapshots without a curve."""
    found = comparison()
    found["snapshots"] = [without_a_curve(snapshot) for snapshot in found["snapshots"]]
    without = {"curve": None, "change_rad": None, "probability_increase": None}
    ended = {"outcome": "no_curve", "reason": because("There is no bench.", code="no_curve")}
    return found | without | ended | changed


def comparison(low=2.12e-4, high=2.81e-4, probability=1.0, names=("before", "after"), reasons=()):
    """A summary of compared snapshots; with reasons the last one is withheld."""
    snapshots = [{"name": name, **part()} for name in names[:-1]]
    snapshots.append({"name": names[-1], **part(9.3e-4, 9.8e-4, reasons)})
    change = None if reasons else between(low, high)
    given_probability = None if reasons else probability
    steps = [
        {"from": a, "to": b, "change_rad": change, "probability_increase": given_probability}
        for a, b in pairwise(names)
    ]
    return {
        "kind": "compare",
        "outcome": "withheld" if reasons else "converged",
        "warnings": [WARNING],
        "answer": {"route": "amplitude", **because("It is the only one.", code="only_route")},
        "snapshots": snapshots,
        "change_rad": change,
        "changes": steps,
        "probability_increase": given_probability,
        "ringing_change": between(0.20, 0.28),
        "probability_ringing_grew": given_probability,
        "same_joint": check(),
        "routes": {"amplitude": {"change_rad": change}},
        "reason": because(*reasons),
        "curve": "results/sweep/result.nc",
        "wear": None,
    }


def of_two_routes(sharp=(2.7e-4, 2.8e-4), code=None):
    """A comparison that simulation answers, with the ringing beside it; they may disagree."""
    found = comparison(*sharp)
    for snapshot in found["snapshots"]:
        beside = snapshot["routes"]["amplitude"]
        simulated = {key: value for key, value in beside.items() if "rmse" not in key}
        simulated |= {"route": "direct", "curve": None, "cramer_rao_sd": {}}
        snapshot |= {**simulated, "routes": {"direct": simulated, "amplitude": beside}}
        for key in ("rmse_rpm", "relative_rmse"):
            del snapshot[key]
    found["answer"] = {"route": "direct", **because("its checks pass", code="sharper_and_checked")}
    found["routes"] = {
        "direct": {"change_rad": found["change_rad"]},
        "amplitude": {"change_rad": between(2.0e-4, 3.0e-4)},
    }
    if code is not None:
        reason = because("The two routes disagree in after.", code=code)
        found |= {"change_rad": None, "probability_increase": None, "reason": reason}
        found["outcome"] = "withheld"
    return found


def printed(summary, folder=None, **options):
    target = console(**options)
    print_result(summary, folder, target)
    return target.file.getvalue()


def flat(text):
    return " ".join(text.split())


# The answer


def test_the_answer_comes_first_in_words():
    first = flat(printed(comparison())).split(" Probability that the gap")[0]
    assert first == (
        "The gap grew by 0.25 mrad (90 % interval 0.21 to 0.28 mrad); "
        "probability that it grew: > 99.9 %. No repair is due. "
        "The gap is 0.955 mrad (90 % interval 0.930 to 0.980 mrad) now."
    )


@pytest.mark.parametrize(
    ("low", "high", "told"),
    [
        (-2.81e-4, -2.12e-4, "The gap shrank by 0.25 mrad (90 % interval 0.21 to 0.28 mrad)"),
        (-1e-4, 2e-4, "may not have changed: the change is 0.05 mrad (90 % interval −0.10 to"),
    ],
)
def test_a_change_is_named_by_where_its_interval_lies(low, high, told):
    text = flat(printed(comparison(low, high, 0.5)))
    assert told in text
    assert "grew by" not in text


def test_a_gap_that_shrank_is_said_first_and_nothing_is_decided():
    summary = comparison(-2.81e-4, -2.12e-4, 0.0)
    assert flat(printed(summary)).startswith("The gap shrank, which wear cannot cause")
    assert answer.advice(summary).title.startswith("Do not decide")


def test_growth_by_ramps_is_told_under_the_condition_that_no_ramp_can_test():
    by_ramps = comparison()
    for snapshot in by_ramps["snapshots"]:
        snapshot["ramps"] = {}
    condition = ", if no flank became softer at small torque."
    assert answer.headline(by_ramps).endswith(f"grew: > 99.9 %{condition}")
    assert condition not in answer.headline(comparison())


@pytest.mark.parametrize(("share", "is_told"), [(0.9, True), (0.1, False)])
def test_growth_that_may_be_wind_up_is_told_under_the_condition_of_its_friction(share, is_told):
    by_encoders = comparison()
    for snapshot in by_encoders["snapshots"]:
        snapshot["budget"] = {"noise": 1.0 - share, "held_windup": share}
    condition = ", if the load's friction did not change."
    assert answer.headline(by_encoders).endswith(condition) == is_told


def test_without_a_curve_the_ringing_alone_is_told():
    text = flat(printed(ringing_alone()))
    assert text.startswith("The ringing grew by 24 % (90 % interval 20 to 28 %);")
    assert "No gap: There is no bench." in text
    assert "above its limit" not in text
    assert "mrad" not in text
    shrunk = ringing_alone(ringing_change=between(-0.3, -0.2), probability_ringing_grew=0.0)
    assert flat(printed(shrunk)).startswith("The ringing shrank by 25 %")


def test_without_a_current_the_first_line_says_on_what_wear_rests():
    spots = check(blind_spots=[{"code": "gains_unseen", "text": "", "delta_error_rad": None}])
    gains = UNSEEN_WITHOUT_CURRENT
    alone = answer.headline(ringing_alone(same_joint=spots))
    assert alone.startswith("The ringing grew by 24 %")
    assert f"only if {gains} did not change: no motor current can be compared." in alone
    by_curve = answer.headline(comparison() | {"same_joint": spots})
    assert by_curve.endswith(f"grew: > 99.9 %, if {gains} did not change.")


def test_by_the_published_curve_the_first_line_says_whose_it_is_and_no_limit_is_asked():
    found = comparison() | {"curve": "published"}
    for snapshot in found["snapshots"]:
        snapshot["curve"] = "published"
    text = flat(printed(found))
    assert text.startswith(answer.OTHER_MACHINE)
    assert "above its limit" not in text


def test_what_changed_besides_the_gap_is_told_once():
    sentence = (
        "The ringing frequency fell from 11.18 to 8.72 Hz: payload, stiffness, gains or a filter "
        "of the drive, not the gap."
    )
    reason = because(f"Something other than the gap changed. {sentence}", code="joint_changed")
    found = comparison() | {"change_rad": None, "probability_increase": None, "reason": reason}
    text = flat(printed(found | {"outcome": "withheld", "same_joint": check(sentence)}))
    assert text.count(sentence) == 1
    assert flat(printed(ringing_alone(same_joint=check(sentence)))).count(sentence) == 1


@pytest.mark.parametrize(("error", "told"), [(2.0e-4, False), (2.2e-4, True)])
def test_growth_that_an_unseen_change_could_make_is_not_told_as_shown(error, told):
    """The interval begins at 0.212 mrad."""
    spot = {**because("K_t by 2 % (too small to show)"), "delta_error_rad": error}
    text = flat(printed(comparison() | {"same_joint": check(blind_spots=[spot])}))
    assert text.startswith("The gap is not shown to have changed") is told
    assert ("but a change of K_t by 2 % (too small to show) could explain as much" in text) is told


def test_a_fit_answers_with_the_gap():
    text = flat(printed({"kind": "fit", "outcome": "converged", "warnings": [], **part()}))
    assert text.startswith("The gap is 0.708 mrad (90 % interval 0.685 to 0.731 mrad).")
    assert "limit of 1.2 mrad: < 0.1 %." in text


def test_every_snapshot_stands_in_the_table_and_every_step_is_told():
    names = ("March", "May", "July")
    text = flat(printed(comparison(names=names)))
    for first, last in (names[:2], names[1:]):
        assert f"From {first} to {last}:" in text
    assert text.count("converged") == 4, "three snapshots and the change"


def test_two_routes_stand_side_by_side_and_one_line_says_which_is_the_answer():
    text = flat(printed(of_two_routes()))
    assert text.startswith("The gap grew by 0.275 mrad (90 % interval 0.270 to 0.280 mrad)")
    assert "The answer is the estimate by simulation, because its checks pass." in text
    assert "the ringing uses the amplitude A and the gap curve of sweep" in text
    assert "change 0.275 0.270 to 0.280 0.25 0.20 to 0.30" in text


def test_the_friction_of_a_simulation_is_told_once():
    found = of_two_routes()
    name = "load_coulomb_friction__torque_nm"
    for snapshot in found["snapshots"]:
        unseen = {"motor_coulomb_friction__torque_nm": between(0.001, 0.05)}
        snapshot["routes"]["direct"]["parameters"] = {name: between(4.0, 6.0)} | unseen
    told = flat(printed(found))
    assert (
        told.count("Friction, fitted with the gap: load Coulomb friction 5.0 (4.0 to 6.0) N m.")
        == 1
    )
    assert "Friction" not in printed(comparison())


def test_a_disagreement_of_the_routes_comes_first():
    text = flat(printed(of_two_routes(code="routes_disagree")))
    lead = "The two routes disagree in after. Find out why the two estimates differ. The change "
    assert text.startswith(f"{lead}of the gap is withheld")
    assert text.count("disagree") == 1


def test_why_another_route_has_no_answer_is_told_once():
    lost, still = (because(text, code="refused") for text in ("It was lost.", "It never turns."))
    note = because("By the amplitude: It was lost.", code="by_amplitude_instead")
    found = comparison()
    for snapshot in found["snapshots"]:
        reasons = [{**note, "because": [lost], "withholds": False}]
        snapshot["diagnostics"] = {**snapshot["diagnostics"], "reasons": reasons}
        for route, reason in {"direct": lost, "two_encoders": still}.items():
            snapshot["routes"][route] = {"route": route, "delta_rad": None, "reason": reason}
    text = flat(printed(found))
    assert text.count("It was lost.") == 1
    assert 'No answer by two encoders of "before", "after": It never turns.' in text


def test_the_ringing_is_always_told_with_its_time_constant_frequency_and_error():
    for summary in (comparison(), of_two_routes()):
        text = flat(printed(summary))
        # τ = 19.5 per second is a time constant of 51.3 ms; 70.5 rad/s are 11.22 Hz.
        assert "31.5 (30.8 to 32.3) 19.5 51.3 11.22 1.82 (30 %)" in text


def test_warnings_sources_and_folder_are_told():
    text = printed(comparison(), Path("results/wear"))
    assert f"Warning: {WARNING}" in flat(text)
    assert "noise of the recording 97.0 %" in flat(text)
    assert "Written to results/wear\n" in text


def test_a_withheld_answer_is_told_with_its_reason_and_without_a_number():
    reason = "The chain is short; raise [posterior] max_steps."
    text = flat(printed(comparison(reasons=[reason])))
    assert text.startswith("The change of the gap is withheld")
    assert f"Withheld: after: {reason}" in text
    assert "after withheld withheld" in text, "the table's row"
    assert "withheld (after)" in text, "the probability above the limit"


def test_a_reason_of_several_snapshots_is_told_once_and_a_note_is_no_reason():
    reason, note = "The curve ends below.", "There is no motor current in the recording."
    summary = comparison(reasons=[reason])
    for snapshot in summary["snapshots"]:
        snapshot |= {"delta_rad": None, "probability_above_limit": None, "reason": because(reason)}
        snapshot["diagnostics"]["reasons"] = [
            {**because(reason), "withholds": True},
            {**because(note), "withholds": False},
        ]
    text = flat(printed(summary))
    assert text.count(reason) == text.count(note) == 1
    assert f"Withheld: before, after: {reason}" in text
    assert f"Note: before, after: {note}" in text


def test_a_gap_that_shrank_without_dates_asks_for_order_and_repair():
    assert answer.SHRANK in flat(printed(comparison(-2.8e-4, -2.1e-4, 0.0)))
    assert answer.SHRANK not in flat(printed(comparison(-1e-4, 2e-4, 0.5)))


def test_an_interval_tells_its_kind():
    summary = comparison()
    summary["change_rad"] = between(2.1e-4, 2.8e-4, "hdi")
    assert "90 % HDI" in flat(printed(summary))


# Probabilities and numbers


@given(st.floats(0.0, 1.0))
def test_a_probability_is_never_certain(value):
    text = words.probability(value)
    number = float(re.search(r"[\d.]+", text).group())
    assert 0.0 < number < 100.0
    assert text.startswith("<") == (value < 1e-3)
    assert text.startswith(">") == (value > 0.999)
    if text[0] not in "<>":
        assert number == pytest.approx(100.0 * value, abs=0.5)


@given(st.floats(-5.0, 5.0), st.floats(1e-6, 3.0))
def test_rounding_never_swallows_an_interval(low, width):
    found = between(low, low + width)
    places = words.decimals(found)
    shown = [float(x) for x in words.bounds(found).replace("−", "-").split(" to ")]
    assert shown[0] < shown[1]
    assert shown[1] - shown[0] == pytest.approx(width, rel=0.21)
    assert "-0" not in number(-0.1 * 10.0**-places, places)


def test_the_unit_read_from_a_name_is_that_of_the_catalogue():
    stated = [(item.name, item.unit) for effect in EFFECTS for item in effect.parameters]
    stated += [(item.name, item.unit) for item in BENCH_PARAMETERS]
    assert len(stated) > 30
    for name, unit in stated:
        words_of_it, found = quantity_and_unit(name)
        assert found == unit, name
        assert "_" not in words_of_it


# The terminal


@pytest.mark.parametrize("reasons", [(), ("R̂ of amplitude_rpm is 1.2 (below 1.05 is needed).",)])
@pytest.mark.parametrize("names", [("before", "after"), ("a" * 60, "the other one " * 4 + "b")])
def test_no_line_is_wider_than_the_terminal(names, reasons):
    text = printed(comparison(names=names, reasons=reasons), Path("results/wear"))
    assert max(len(line) for line in text.splitlines()) <= 80


@pytest.mark.parametrize("width", [40, 60, 80, 120])
def test_every_cell_of_a_table_is_printed_whole(width):
    summary = comparison()
    text = printed(summary, width=width)
    for snapshot in summary["snapshots"]:
        assert words.bounds(snapshot["delta_rad"], 1e3, 3) in text
        assert f"{snapshot['rmse_rpm']:.2f}" in text
    for title in ("RMSE", "90 % interval"):
        assert title in text
    assert text.count("converged") == len(summary["snapshots"]) + 1


def test_a_pipe_gets_no_colour_codes_and_a_terminal_does():
    assert "\x1b" not in printed(comparison())
    assert "\x1b" in printed(comparison(), terminal=True)


def test_numbers_stay_with_their_signs_and_units():
    for width in range(20, 60):
        lines = wrapped("probability that it grew: > 99.9 %; by 0.25 mrad", width).split("\n")
        assert all(len(line) <= width for line in lines)
        assert any("> 99.9 %" in line for line in lines)
        assert any("0.25 mrad" in line for line in lines)


def test_an_error_is_one_line_with_its_brackets():
    target = console()
    path = "/a/very/long/path/that/does/not/fit/into/a/line/of/eighty/characters/recording.csv"
    error(target, RecordingError("Not a number.", file=path, where="[[recordings]] 1", found="[x]"))
    text = target.file.getvalue()
    assert text == f"Error: {path}, [[recordings]] 1: Not a number. Found: [x].\n"


def test_an_error_without_a_place_is_told_too():
    target = console()
    error(target, ConfigError("Nothing to do."))
    assert target.file.getvalue() == "Error: Nothing to do.\n"


def test_progress_names_the_stage_on_a_terminal():
    target = console(terminal=True, width=100)
    with progress(target) as tell:
        tell("Sampling before", 900, 20_000)
        tell("Sampling after [1]", 100, 20_000)
    last = target.file.getvalue().rpartition("Sampling ")[2]
    assert last.startswith("after [1]")
    assert "100/20000" in last


def test_a_pipe_gets_no_progress_even_where_colours_are_forced(monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    target = Console(file=io.StringIO())
    assert target.is_terminal
    with progress(target) as tell:
        tell("before", 100, 20_000)
    assert target.file.getvalue() == ""


# Inspecting a stored result


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A small fit as a tree."""
    folder = tmp_path_factory.mktemp("fit")
    time = np.arange(1000) / 250.0
    train = pulse_train(time, QUICK, 1.0 / 250.0)
    speed = 2000.0 + 30.0 * train + np.random.default_rng(1).standard_normal(time.size)
    table = np.c_[time, speed]
    header = "time_s,motor_speed_rpm"
    np.savetxt(folder / "one.csv", table, "%.9g", ",", header=header, comments="")
    (folder / "fit.toml").write_text(
        'schema = 1\nkind = "fit"\n[run]\noutput = "x"\n[posterior]\nensembles = 2\n'
        'max_steps = 100\n[curve]\nsource = "published"\n[[recordings]]\nfile = "one.csv"\n'
    )
    return measure(load_config(folder / "fit.toml"))


def test_inspect_prints_every_parameter_with_its_unit_and_the_origin(stored):
    target = console()
    print_summary(stored, target)
    text = target.file.getvalue()
    for symbol in SYMBOLS.values():
        quantity, _ = quantity_and_unit(symbol.name)
        (row,) = [line for line in text.splitlines() if line.startswith(f"{quantity}  ")]
        assert row.rstrip().endswith(symbol.unit)
        assert ("fixed" in row) == symbol.name.startswith("window")
    for told in ("RMSE", "Noise:", "Sampling:", "Rival optima:", "SHA-256", "Seed: 1", "commit"):
        assert told in text
    assert flat(text).startswith(answer.headline(_summary(stored)))


def test_a_bound_that_is_not_finite_is_a_dash():
    size = {"load_inertia_kg_m2": 0.2}
    found = {"parameters": {"load_inertia_kg_m2": between(19.0, 21.0)}, "optimum": size}
    stored = found | {"posterior_sd": size, "cramer_rao_sd": {"load_inertia_kg_m2": None}}
    ((_, _, sd, bound, _, unit),) = estimates.parameter_table(stored | {"delta_rad": None}).rows
    assert (sd, bound, unit) == ("0.200", "–", "kg m²")


def test_noise_is_told_with_its_evidence():
    found = part()
    assert estimates.noise(found) == (
        "AR(1), standard deviation 1.51 rpm in speed, coefficients 0.600 "
        "(log evidence for Student-t: −10)"
    )
    found["noise"] |= {
        "kind": "student_t",
        "degrees_of_freedom": 3.0,
        "student_t_evidence": 3021.4,
        "repeating_rounding_sd_rpm": 5.98,
    }
    assert (
        "Student-t with 3 degrees of freedom (log evidence for Student-t: 3021)"
        in estimates.noise(found)
    )
    assert estimates.noise(found).endswith("and rounding of 5.98 rpm that repeats every rotation")


def test_inspect_of_a_withheld_fit_gives_no_gap(stored):
    withheld = copy.copy(stored)
    summary = json.loads(stored.attrs["summary"])
    reason = because("Too weak.")
    for one in (summary, *summary["routes"].values()):
        one |= {"delta_rad": None, "outcome": "withheld", "reason": reason}
        one["diagnostics"] |= {"reasons": [{**reason, "withholds": True}]}
    withheld.attrs = {**stored.attrs, "summary": json.dumps(summary)}
    target = console()
    print_summary(withheld, target)
    text = flat(target.file.getvalue())
    assert text.startswith("The gap is withheld")
    assert "Withheld: Too weak." in text
    assert not re.search(r"\d mrad", text)


def _summary(tree):
    from bayesbl.runs.kinds import summarise

    return summarise(tree)


# Sweeps


def sweep_summary(**changes):
    found = {
        "kind": "sweep",
        "outcome": "converged",
        "reason": None,
        "warnings": [],
        "curve": "results/sweep",
        "coefficients": [-1.921674e-06, 1.283017e-05, 2.922097e-07, -4.716268e-10],
        "degree": 3,
        "gap_rad": [1e-4, 4e-3],
        "amplitude_rpm": [6.89, 104.7],
        "largest_correction": 0.0106,
        "relative_sd": {"regression": 0.00036, "lack_of_fit": 0.00055, "bench": 0.051},
        "largest_departure_from_published": 0.0324,
        "degrees": {
            "2": {"rms_departure": 0.0103, "largest_departure": 0.0256, "log_evidence": 795.7},
            "3": {"rms_departure": 0.0015, "largest_departure": 0.0033, "log_evidence": 820.0},
            "4": {"rms_departure": 0.0007, "largest_departure": 0.0016, "log_evidence": 822.6},
        },
    }
    return found | changes


def test_a_sweep_is_told_with_its_ranges_first():
    first = flat(printed(sweep_summary())).split(" A cubic")[0]
    assert first == (
        "As the gap grows from 0.1 to 4 mrad, the amplitude A of the ringing grows from 6.9 to "
        "104.7 rpm."
    )


def test_every_coefficient_has_its_unit_and_can_be_read_back():
    text = printed(sweep_summary()).replace("−", "-")
    for value, unit in zip(
        sweep_summary()["coefficients"], ("rad", "rad/rpm", "rad/rpm²", "rad/rpm³"), strict=True
    ):
        (found,) = re.findall(rf"(-?\d\.\d+e-\d+)\s+{unit}\s*$", text, re.MULTILINE)
        assert float(found) == pytest.approx(value, rel=1e-6)


def test_every_source_of_the_curve_is_told_the_largest_first():
    told = flat(printed(sweep_summary(relative_sd={"bench": 0.051, "oil_warmth": 0.2})))
    assert "by source: oil warmth 20 %, tolerances of the bench 5.1 %." in told


def test_what_is_left_is_told_of_the_cubic_of_eq_4_and_of_the_coefficients_alone():
    told = flat(printed(sweep_summary()))
    assert "A cubic describes δ of the sweep within 0.33 % (0.15 % RMS)." in told
    assert "eq. 4 by at most 3.2 %." in told
    assert "at most 1.1 %" in told


def test_the_degree_used_is_marked_and_evidence_is_given_below_the_best():
    lines = printed(sweep_summary()).splitlines()
    (used,) = [line for line in lines if line.rstrip().endswith("used")]
    assert used.split()[:4] == ["3", "0.15", "0.33", "2.6"]
    (best,) = [line for line in lines if line.split()[:1] == ["4"]]
    assert best.split()[-1] == "0.0"


@pytest.mark.parametrize("width", [60, 80, 120])
def test_a_sweep_is_never_wider_than_the_terminal(width):
    assert max(map(len, printed(sweep_summary(), width=width).splitlines())) <= width


def test_significant_digits_are_kept_whatever_the_size():
    values = (0.000149, 0.15, 1.04, 32.6, 0.0, -2.55)
    assert [words.significant(v) for v in values] == ["0.00015", "0.15", "1.0", "33", "0", "−2.5"]


# A diagnosis


def diagnosis(*closed):
    """The summary of a diagnosis by several channels with these shares of disagreement removed."""
    row = {"before": 2.0, "after": 1.0, "noise_floor": 1.0, "unit": "rpm"}
    uses = [{"used": {**row, "closed_fraction": share}} for share in closed]
    return {
        "kind": "diagnose",
        "verdict": "nothing_missing",
        "outcome": "done",
        "effects": [],
        "parameter_errors": [],
        "disagreement": {
            "unit": None,
            "recordings": {f"r{i}": {"motor_speed_rpm": use} for i, use in enumerate(uses)},
            "over_all": {},
        },
        "remaining": [],
        "delta_rad_before": None,
        "delta_rad_after": None,
        "suggested_recording": None,
        "warnings": [],
    }


def test_a_share_that_cannot_be_told_is_a_dash_with_its_reason():
    text = flat(printed(diagnosis(0.998, None)))
    assert "1.00 rpm – " in text
    assert UNTOLD_SHARE in text
    assert "–" not in printed(diagnosis(0.998))


@given(st.floats(-10.0, 10.0))
def test_no_more_than_all_of_a_disagreement_is_told_as_removed(closed):
    told = removed(closed)
    assert float(told.removesuffix(" %").replace("−", "-")) == pytest.approx(
        min(100.0 * closed, 100.0), abs=0.05001
    )


def test_a_data_sheet_that_no_joint_can_be_as_is_not_said_to_be_compared():
    def told(before):
        return compared({"disagreement": {"over_all": {"used": {"before": before, "after": 1.0}}}})

    assert told(14.7) == "Before: the data sheet's values. After: the identified bench."
    assert told(1.0).startswith("The data sheet's values cannot be simulated")


# Studies

COLUMNS = ["name", "pairs", "coverage_90", "bias_percent", "width_ratio", "median_error_percent"]
VALUES = ("bench, AR(1) 0.6, δ 2e-4", 300, 0.893333, -0.0123, 1.0123, 1.2)
ROWS = [dict(zip(COLUMNS, VALUES, strict=True)), {"name": "[b]", "pairs": 12}]


def study(width):
    target = console(width=width)
    print_table(study_table(ROWS, COLUMNS), target)
    return target.file.getvalue()


@pytest.mark.parametrize("width", [40, 60, 80, 100, 200])
def test_every_value_of_a_study_is_printed_whole_beside_its_column(width):
    text = study(width)
    assert "…" not in text
    for row in ROWS:
        for column, value in row.items():
            assert column in text or column == "name"
            assert str(value) in text
    if width >= 60:
        assert max(map(len, text.splitlines())) <= width


def test_a_study_that_fits_is_a_table_and_one_that_does_not_a_block_a_row():
    assert study(200).splitlines()[0].split() == COLUMNS
    narrow = study(60).splitlines()
    assert narrow[0] == "bench, AR(1) 0.6, δ 2e-4"
    assert narrow[1].startswith("  pairs 300, coverage_90 0.893333,")
    assert narrow[-2:] == ["[b]", "  pairs 12"]


@given(
    st.lists(st.text("ab ", min_size=1, max_size=12).map(str.strip).filter(bool), min_size=1),
    st.integers(1, 40),
)
def test_pairs_are_broken_between_them_alone(pairs, width):
    lines = filled(pairs, width)
    assert " ".join(lines) == ", ".join(pairs)
    alone = {len(pair) + 1 for pair in pairs}
    assert all(len(line) <= max(width, *alone, 0) for line in lines)


def test_a_withheld_gap_beyond_the_curve_claims_no_certainty():
    curve = published_curve(draws=50)
    amplitude = np.random.default_rng(1).normal(190.0, 0.5, (2, 200))
    ringing = MeasuredRinging(amplitude, np.array([190.0, 4.2, 2.9]), np.diag([0.25, 1e-4, 1e-4]))
    (found,) = gaps(curve, [ringing], np.random.SeedSequence(1))
    assert np.all(found.outside_curve == 1.0)
    (reason,) = found.reasons
    told = sentence(reason.stored)
    assert "More than 99 % of the posterior" in told
    assert "100" not in told
