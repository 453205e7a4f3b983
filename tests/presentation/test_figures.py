"""Laws of the figures: they show what is stored, all of it, and say where an answer is withheld."""

from __future__ import annotations

import errno
import json
import os
import re
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr
from added_module import added_module
from matplotlib.figure import Figure
from stored_measurement import judged, stored_comparison
from synthetic_ringing import QUICK

from bayesbl.config.bench import dump_bench, reference_bench
from bayesbl.config.loading import load_config
from bayesbl.curve.gap_curve import PUBLISHED_COEFFICIENTS
from bayesbl.measurement.curves import curve_from_dataset
from bayesbl.measurement.routes import measure
from bayesbl.measurement.stored import routes_of
from bayesbl.presentation import figures
from bayesbl.presentation.figures.diagnosis import held_out
from bayesbl.presentation.figures.gap import amplitude_to_gap, density, gap
from bayesbl.presentation.figures.ringing import signal
from bayesbl.presentation.figures.stored_figure import draw_all, figures_of, snapshots
from bayesbl.presentation.figures.style import envelope, publication_style, save
from bayesbl.presentation.figures.sweep import (
    curve,
    departures_from_curve,
    disturbance,
    source_bands,
)
from bayesbl.results.store import read_tree, write_tree
from bayesbl.ringing.symbols import SYMBOLS
from bayesbl.ringing.waveform import pulse_train
from bayesbl.runs.kinds import result_of_run

FIXED = ("window_start_s", "window_end_s")
FREE = tuple(name for name in SYMBOLS if name not in FIXED)

CONFIG = """
schema = 1
kind = "compare"
[run]
output = "result"
[joint]
limit_rad = 1.2e-3
[curve]
source = "published"
[posterior]
ensembles = 2
max_steps = 150
[[recordings]]
name = "old"
file = "old.csv"
[[recordings]]
name = "new"
file = "new.csv"
"""

SWEEP = """
schema = 1
kind = "sweep"
bench = "bench.toml"
[run]
workers = 1
output = "sweep"
[sweep]
gap_rad = {low = 2e-4, high = 3e-3, count = 8}
start_angles = 2
rotations = 2.0
sampling_hz = 500.0
bench_draws = 6
"""

BOTH = ("pdf", "png")


def write_recording(path, amplitude_rpm, samples, seed):
    """A low-rate recording of the disturbance model, with rotations of 1.4 s."""
    time = np.arange(samples) / 250.0
    train = pulse_train(time, QUICK, 1.0 / 250.0)
    noise_rpm = np.random.default_rng(seed).standard_normal(samples)
    speed = 2000.0 + amplitude_rpm * train + noise_rpm
    columns = "time_s,motor_speed_rpm"
    np.savetxt(path, np.c_[time, speed], "%.9g", ",", header=columns, comments="")


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """A stored comparison of two recordings, the second one shorter."""
    folder = tmp_path_factory.mktemp("compare")
    write_recording(folder / "old.csv", 30.0, 1300, 1)
    write_recording(folder / "new.csv", 40.0, 1000, 2)
    (folder / "compare.toml").write_text(CONFIG)
    write_tree(judged(measure(load_config(folder / "compare.toml"))), folder / "result.nc")
    return folder / "result.nc"


@pytest.fixture(scope="module")
def tree(file):
    return read_tree(file)


@pytest.fixture(scope="module")
def drawn(tree, tmp_path_factory):
    """Every file that ``draw_all`` writes, by name."""
    return {path.name: path for path in draw_all(tree, tmp_path_factory.mktemp("figures"), BOTH)}


def texts(figure):
    """All visible text of a figure."""
    found = [t for t in figure.findobj(mpl.text.Text) if t.get_visible()]
    return "\n".join(t.get_text() for t in found)


def labelled(axes, label):
    """The one line of a panel with a label."""
    (line,) = [line for line in axes.lines if line.get_label() == label]
    return line


# What is drawn is what is stored


@pytest.mark.parametrize("share", [0.5, 0.8, 0.99])
def test_a_density_of_draws_that_are_mostly_of_no_gap_is_one(share):
    generator = np.random.default_rng(1)
    draws = np.where(generator.uniform(size=4000) < share, 0.0, generator.lognormal(size=4000))
    across, heights = density(draws)
    assert np.all(heights >= 0.0)
    assert np.trapezoid(heights, across) == pytest.approx(1.0, abs=0.2)


def test_pulses_are_drawn_sample_by_sample(tree):
    axes = signal(tree).axes
    for snapshot, panels in zip(snapshots(tree), (axes[:6], axes[6:]), strict=True):
        stored = dict(
            zip(
                snapshot.time_s,
                zip(
                    snapshot.values("observed_data", "motor_speed_rpm"),
                    snapshot.values("predictive", "model_rpm"),
                    strict=True,
                ),
                strict=True,
            )
        )
        for panel in (panels[1], panels[2]):
            measured, model = labelled(panel, "measured"), labelled(panel, "model")
            expected = np.array([stored[t] for t in measured.get_xdata()])
            assert len(expected) > 50
            assert np.array_equal(measured.get_ydata(), expected[:, 0])
            assert np.array_equal(model.get_ydata(), expected[:, 1])


def test_a_positive_pulse_rises_and_a_negative_one_falls(tree):
    axes = signal(tree).axes
    for panel, sign in ((axes[1], 1.0), (axes[2], -1.0)):
        speed = sign * (labelled(panel, "model").get_ydata() - 2000.0)
        assert np.argmax(speed) < np.argmin(speed)
        assert speed.max() > -speed.min()


def test_an_outline_keeps_every_extreme():
    generator = np.random.default_rng(3)
    time, values = np.arange(10_001.0), generator.standard_normal(10_001)
    values[[17, 9_000]] = 50.0, -60.0
    middle, low, high = envelope(time, values, 300)
    assert middle.size == 300
    assert high.max() == 50.0
    assert low.min() == -60.0
    for begin in (0, 4_321, 9_990):
        inside = np.interp(np.arange(begin, begin + 5), middle, np.arange(300)).round().astype(int)
        assert np.all(low[inside] <= values[begin : begin + 5].max())


def test_a_short_signal_is_outlined_by_its_own_samples():
    middle, low, high = envelope(np.arange(5.0), np.array([0.0, 1.0, 0.0, -1.0, 0.0]), 700)
    assert middle.size == 4
    assert np.array_equal(high, [1.0, 1.0, 0.0, 0.0])
    assert np.array_equal(low, [0.0, 0.0, -1.0, -1.0])


def test_the_curve_is_drawn_with_the_draws_that_went_through_it(tree):
    figure = amplitude_to_gap(tree)
    main = figure.axes[0]
    (line,) = [line for line in main.lines if "gap curve" in str(line.get_label())]
    stored = tree["amplitude/curve"]["delta_rad"].values
    assert np.array_equal(line.get_ydata(), 1e3 * stored)
    assert labelled(main, "limit 1.2 mrad").get_ydata()[0] == pytest.approx(1.2)
    for snapshot in snapshots(tree):
        through = snapshot.values("posterior", "curve_amplitude_rpm").ravel()
        shown = [x for x in main.lines if x.get_marker() == "." and len(x.get_xdata()) > 100]
        assert any(np.isin(x.get_xdata(), through).all() for x in shown)


def test_the_gap_figure_shows_gaps_limit_and_change_as_stored(tree):
    gaps, change = gap(tree).axes
    assert any(np.allclose(line.get_xdata(), 1.2) for line in gaps.lines)
    shown = texts(gap(tree))
    told = [tuple(map(float, x)) for x in re.findall(r"\(([\d.]+) to ([\d.]+)\)", shown)]
    for draws in (*tree["gap"]["delta_rad"].values, tree["change"]["change_rad"].values):
        ends = 1e3 * np.quantile(draws, [0.05, 0.95])
        assert any(np.allclose(ends, pair, rtol=0.0, atol=0.1 * np.ptp(ends)) for pair in told)
    assert change.get_xlim()[0] < 1e3 * float(tree["change"]["change_rad"].median())


def test_no_letter_is_smaller_than_journals_take(tree):
    sizes = [t.get_fontsize() for t in gap(tree).findobj(mpl.text.Text) if t.get_text()]
    assert min(sizes) >= 7.0


# Files


def test_figures_come_from_the_file_alone_and_are_the_same_bytes_again(file, drawn, tmp_path):
    tree = read_tree(file)
    with publication_style():
        again = save(gap(tree), tmp_path, "gap", BOTH) + save(
            signal(tree), tmp_path, "signal", BOTH
        )
    for path in again:
        assert path.read_bytes() == drawn[path.name].read_bytes(), path.name


def test_every_figure_is_there_as_pdf_and_png(drawn):
    corners = {f"corner_{name}" for name in ("old", "new")}
    names = {"signal", "gap", "amplitude_to_gap", *corners}
    assert set(drawn) == {f"{name}.{kind}" for name in names for kind in ("pdf", "png")}
    assert all(path.stat().st_size < 500_000 for path in drawn.values())


class FullDisk(Figure):
    def savefig(self, path, **_):
        Path(path).write_bytes(b"half a figure")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_half_a_figure_is_not_left(tmp_path):
    with pytest.raises(OSError, match=r"half\.png"):
        save(FullDisk(), tmp_path, "half", BOTH[::-1])
    assert not list(tmp_path.iterdir())


A_FIGURE = """
from bayesbl.presentation.figures.stored_figure import holding, stored_figure
from bayesbl.presentation.figures.style import new_figure


@stored_figure("How long each recording is.", 999, holding("constant_data/time_s"))
def durations(tree):
    figure = new_figure(3.0, 2.0)
    figure.add_subplot().plot(tree["amplitude/constant_data"]["time_s"].max("sample"))
    return figure
"""


def test_a_file_in_the_folder_of_figures_is_a_figure(tree, tmp_path, monkeypatch):
    module = tmp_path / "modules" / "durations.py"
    module.parent.mkdir()
    module.write_text(A_FIGURE)
    with added_module(figures, module):
        assert [figure.name for figure in figures_of(tree)][-1] == "durations"
        only = [figure for figure in figures_of(tree) if figure.name == "durations"]
        monkeypatch.setattr("bayesbl.presentation.figures.stored_figure.figures_of", lambda _: only)
        (pdf, png) = draw_all(tree, tmp_path / "figures", BOTH)
    assert {pdf.name, png.name} == {"durations.pdf", "durations.png"}
    assert pdf.stat().st_size > 1000
    monkeypatch.undo()
    assert "durations" not in [figure.name for figure in figures_of(tree)]


def test_pdf_text_is_embedded_truetype_without_a_date(drawn):
    for name, path in drawn.items():
        if name.endswith(".pdf"):
            content = path.read_bytes()
            assert b"/CIDFontType2" in content, name
            assert b"/Type3" not in content, name
            assert b"/CreationDate" not in content, name


def test_a_users_settings_of_matplotlib_change_nothing_and_stay(tree):
    with mpl.rc_context({"font.size": 31.0, "lines.linewidth": 9.0}):
        figure = signal(tree)
        assert mpl.rcParams["font.size"] == 31.0
    assert figure.axes[1].xaxis.label.get_size() == 7.0


def test_a_result_that_no_figure_shows_has_none(tmp_path):
    other = xr.DataTree()
    other.attrs = {"kind": "plan"}
    assert draw_all(other, tmp_path, BOTH) == []


# Withheld answers


def test_a_withheld_gap_is_said_so_and_its_number_is_not_given(tree):
    whole = texts(gap(tree))
    assert "withheld" not in whole
    assert len(re.findall(r"\d  \(", whole)) == 3
    shown = texts(gap(judged(tree, "new")))
    assert shown.count("withheld") == 2, "the gap and the change"
    assert len(re.findall(r"\d  \(", shown)) == 1, "only the snapshot that has an answer"


def test_withheld_gaps_whose_draws_are_all_the_same_are_drawn(tree):
    same = judged(tree, "new")
    for route in routes_of(same):
        held = same[f"{route}/posterior"]
        held["delta_rad"] = xr.zeros_like(held["delta_rad"])
    assert "withheld" in texts(gap(same))


# A sweep


@pytest.fixture(scope="module")
def sweep_file(tmp_path_factory):
    """A stored sweep of the reference bench, two of its parameters known to 5 %."""
    folder = tmp_path_factory.mktemp("sweep")
    bench = dump_bench(reference_bench())
    for name in ("shaft_stiffness_nm_per_rad", "speed_gain_nm_s_per_rad"):
        head = f"[parameters.{name}]\n"
        assert head in bench
        bench = bench.replace(head, f"{head}relative_tolerance = 0.05\n")
    (folder / "bench.toml").write_text(bench)
    (folder / "sweep.toml").write_text(SWEEP)
    write_tree(result_of_run(load_config(folder / "sweep.toml")), folder / "result.nc")
    return folder / "result.nc"


@pytest.fixture(scope="module")
def swept(sweep_file):
    return read_tree(sweep_file)


def points(figure, label):
    """Every point of the one line with a label in any panel, shape (n, 2)."""
    (line,) = [x for axes in figure.axes for x in axes.lines if str(x.get_label()) == label]
    return np.column_stack([line.get_xdata(), line.get_ydata()])


@pytest.mark.long
def test_the_curve_figure_shows_every_sweep_point_and_the_stored_curve(swept):
    figure = curve(swept)
    shown = points(figure, "sweep: 8 gaps, 2 start angles")
    amplitude = swept["sweep"]["amplitude_rpm"].values
    assert np.array_equal(shown[:, 0], amplitude.ravel())
    assert np.array_equal(shown[:, 1], 1e3 * np.repeat(swept["sweep"]["gap_rad"].values, 2))
    drawn = points(figure, "curve: cubic with lack of fit")
    assert np.array_equal(drawn[:, 0], swept["curve"]["amplitude"].values)
    assert np.array_equal(drawn[:, 1], 1e3 * swept["curve"]["delta_rad"].values)


def test_eq_4_is_shown_for_the_bench_that_it_was_made_for_alone(swept):
    other = swept.copy()
    shaft = "shaft_stiffness_nm_per_rad"
    bench = reference_bench()
    other.attrs["bench"] = dump_bench(bench.with_parameters(**{shaft: 2.0 * bench.value(shaft)}))
    assert "eq. 4" in texts(curve(swept))
    shown = texts(curve(other))
    assert "eq. 4" not in shown
    assert "tolerances of the bench" in shown


def test_every_source_of_the_curve_has_its_band(swept):
    bands = source_bands(swept)
    assert set(bands) == {"regression", "lack_of_fit", "bench"}
    stored = swept["curve"]["source_bench"].values
    inside = (100.0 * np.expm1(stored) >= bands["bench"][0]) & (
        100.0 * np.expm1(stored) <= bands["bench"][1]
    )
    assert np.allclose(inside.mean(axis=0), 0.9, atol=0.01)
    shown = texts(curve(swept))
    for name in (
        "coefficients of the curve",
        "lack of fit of the curve",
        "tolerances of the bench",
    ):
        assert re.search(rf"^{name}$", shown, re.MULTILINE), name


def test_a_source_that_is_not_known_is_drawn_and_named_too(swept):
    more = swept.copy()
    stored = swept["curve"].to_dataset()
    draws = stored["source_regression"].rename(draw_regression="draw_oil_warmth")
    more["curve"] = xr.DataTree(stored.assign(source_oil_warmth=draws))
    assert "oil warmth" in texts(curve(more))


def test_departures_are_those_of_the_sweep_and_of_eq_4_from_the_curve(swept):
    departure = departures_from_curve(swept)
    stored = curve_from_dataset(swept["curve"].to_dataset(), "")
    amplitude = swept["sweep"]["amplitude_rpm"].values
    back = stored.gap(amplitude) * (1.0 + departure / 100.0)
    assert np.allclose(back, swept["sweep"]["gap_rad"].values[:, None], rtol=1e-12)
    eq4 = curve(swept).axes[1].lines[0]
    x, y = eq4.get_xdata(), eq4.get_ydata()
    cubic = np.polynomial.polynomial.polyval(x, 1e-4 * np.array(PUBLISHED_COEFFICIENTS))
    assert len(x) > 100
    assert np.allclose(stored.gap(x) * (1.0 + y / 100.0), cubic, rtol=1e-9)


def test_the_disturbance_is_drawn_sample_by_sample_with_both_pulses_in_view(swept):
    figure = disturbance(swept)
    examples = swept["examples"].to_dataset()
    for gap_rad, speed in zip(
        examples["gap_rad"].values, examples["motor_speed_rpm"].values, strict=True
    ):
        shown = points(figure, f"δ = {1e3 * gap_rad:.2f} mrad")
        assert np.array_equal(shown[:, 1], speed)
    largest = examples["motor_speed_rpm"].values[-1]
    _, positive, negative = figure.axes
    assert positive.lines[-1].get_ydata().max() == largest.max()
    assert negative.lines[-1].get_ydata().min() == largest.min()


def test_a_pulse_that_runs_over_the_end_of_the_rotation_is_drawn_whole(swept):
    """The rotation begins anywhere: turned by any amount, the views hold the same samples."""
    examples = swept["examples"].to_dataset()
    speed = examples["motor_speed_rpm"].values
    peak = int(np.argmax(speed[-1]))
    turned = np.roll(speed[:, :-1], -peak, axis=1)
    other = swept.copy()
    closed = np.concatenate([turned, turned[:, :1]], axis=1)
    other["examples"] = xr.DataTree(
        examples.assign(motor_speed_rpm=examples["motor_speed_rpm"].copy(data=closed))
    )
    before, after = (disturbance(t).axes[1].lines[-1].get_ydata() for t in (swept, other))
    assert abs(len(before) - len(after)) <= 1, "a sample on the edge may fall on either side"
    assert np.isin(before[1:-1], after).all()


# Nothing runs out of a figure


def beyond(figure):
    """Texts of a figure that its page cuts off; matplotlib keeps ticks beyond the view too."""
    figure.canvas.draw()
    page, text = figure.bbox.padded(0.5), mpl.text.Text
    ticks = {id(t) for tick in figure.findobj(mpl.axis.Tick) for t in tick.findobj(text)}
    found = [t for t in figure.findobj(text) if t.get_visible() and t.get_text()]
    boxes = [(t.get_text(), t.get_window_extent()) for t in found if id(t) not in ticks]
    return [
        told
        for told, box in boxes
        if not all(map(page.contains, *zip(box.min, box.max, strict=True)))
    ]


def of_two_routes(names):
    """As much of a comparison by two routes as the figure of the gaps reads."""
    generator = np.random.default_rng(1)
    dims = ("snapshot", "chain", "draw")
    middle = 7e-4 + 1e-4 * np.arange(len(names))[:, None, None]
    sharp, wide = (
        xr.Dataset(
            {"delta_rad": (dims, middle + sd * generator.standard_normal((len(names), 2, 500)))},
            {"snapshot": names},
        )
        for sd in (2e-6, 3e-5)
    )
    return stored_comparison(
        names,
        {"direct": {"posterior": sharp}, "amplitude": {"posterior": wide}},
        change=_steps(sharp["delta_rad"].values, names),
    )


def _steps(draws, names):
    return xr.Dataset(
        {
            "change_rad": (("chain", "draw"), draws[-1] - draws[0]),
            "step_change_rad": (("step", "chain", "draw"), np.diff(draws, axis=0)),
        }
    )


@pytest.mark.parametrize("count", [2, 5])
def test_both_routes_stand_side_by_side_on_one_axis(count):
    names = [f"snapshot_{n}" for n in range(count)]
    figure = gap(of_two_routes(names))
    gaps, change = figure.axes
    assert len(gaps.get_yticklabels()) == 2 * count
    assert len(change.get_yticklabels()) == 2 + (count - 1 if count > 2 else 0)
    assert beyond(figure) == []


def compared_result():
    """As much of a diagnosis as the figure of a held-out recording reads; the bench lacks a peak.

    Two channels, one recording that was fitted and two that were held out, the second far worse.
    """
    generator = np.random.default_rng(4)
    time = np.arange(2000) / 100.0
    recordings, rows = {}, []
    for name, use, peak in (("a", "used", 9.0), ("b", "held_out", 3.0), ("c", "held_out", 6.0)):
        recordings[name] = {}
        for channel, floor in (("motor_speed_rpm", 1.0), ("motor_current_a", 0.1)):
            after = floor * np.sin(time)
            before = after - floor * peak * np.exp(-(((time - 7.0) / 0.1) ** 2))
            measured = after + floor * generator.standard_normal(time.size)
            size = {
                k: float(np.std(measured - x)) for k, x in (("before", before), ("after", after))
            }
            recordings[name][channel] = {use: size | {"noise_floor": floor}}
            if use == "held_out":
                rows.append((name, channel, use, time, measured, before, after))
    keys = ("recording", "channel", "use", "time_s", "measured", "before", "after")
    signals = xr.Dataset(
        {
            key: (("piece", "sample") if np.ndim(values[0]) else "piece", list(values))
            for key, values in zip(keys, zip(*rows, strict=True), strict=True)
        }
    )
    tree = xr.DataTree.from_dict({"signals": signals})
    answer = {
        "verdict": "unexplained", "remaining": [], "effects": [],
        "disagreement": {"recordings": recordings, "over_all": {}},
    }  # fmt: skip
    tree.attrs = {"summary": json.dumps(answer), "kind": "diagnose"}
    tree.attrs |= dict.fromkeys(("version", "commit", "seed", "outcome", "reason"), "")
    tree.attrs["warnings"] = []
    return tree, recordings["c"]


def test_the_recording_held_out_shows_where_and_by_how_much_less_the_bench_disagrees():
    tree, worst = compared_result()
    ((ending, drawn_from),) = held_out.parts(tree)
    assert ending == ""
    assert drawn_from[1:] == ("c", "held_out"), "the one that the bench as given predicts worst"
    figure = held_out(*drawn_from)
    before, after, zoom = figure.axes[:3]
    assert before.get_ylim() == after.get_ylim()
    assert before.get_ylim()[1] > 6.0
    begin, end = zoom.get_xlim()
    assert begin < 7.0 < end
    shown = texts(figure)
    for channel, unit in (("motor_speed_rpm", "rpm"), ("motor_current_a", "A")):
        size = worst[channel]["held_out"]
        assert f"before: RMS {size['before']:.3g} {unit}" in shown
        assert f"noise floor {size['noise_floor']:#.3g} {unit}" in shown
    ends = {
        round(float(x), 6)
        for line in figure.axes[-1].lines
        for x in line.get_xdata()
        if line.get_marker() != "None"
    }
    for channels in worst.values():
        size = channels["held_out"]
        assert round(size["before"] / size["noise_floor"], 6) in ends
        assert round(size["after"] / size["noise_floor"], 6) in ends
    assert beyond(figure) == []
