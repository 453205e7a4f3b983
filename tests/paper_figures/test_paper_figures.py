"""Laws of the paper's figures: their arrays stay what they were, and are what was stored."""

from __future__ import annotations

import csv
import importlib
import json
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr
from calibration_figure import draw_calibration
from calibration_table import calibration_line
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox
from paper_results import FROM_TABLES, GOLDEN, SAMPLED, described, make
from places import EXPERIMENTS, ROOT

from bayesbl.bench.effects import EFFECTS
from bayesbl.presentation.figures.stored_figure import snapshots
from bayesbl.presentation.figures.style import publication_style

pytestmark = pytest.mark.long

SCRIPTS = ROOT / "paper_figures"
TABLES = EXPERIMENTS / "results"
sys.path.insert(0, str(SCRIPTS))
common = importlib.import_module("common")
make_all = importlib.import_module("make_all")
FIGURES = {figure.name: figure for figure in make_all.FIGURES}

EXACT = 1e-3
"""Of an array's largest value: simulator and optimum converge to that, whatever the machine."""

MONTE_CARLO = 0.07
"""Of the 90 % width of draws: three standard errors of the difference of two runs.

A 5 % quantile of 1500 effective normal draws has a standard error of 0.0546 standard deviations,
the difference of two √2 times that, and the width is 3.29.
"""

OF_TAILS = {"wear/law_shape": 0.15, "wear/scatter_rad_per_root_year": 0.16}
"""The same where a quantile lies in a sparse tail.

Two thirds of the draws or more of a law's shape have one value, here that of a linear law. The
scatter has a tail longer than an exponential's, whose 95 % quantile has a standard error of 0.038
widths.
"""

OF_DRAWS = {
    "uncertainty_budget": {"share": 0.03, "log_sd": 0.06, "along_percent": 0.06},
    # Some 600 draws in the highest bin, half of them copies: 5 % each, over 88 bins.
    "shared_curve": {"density_per_mrad": 0.18, "interval_mrad": 0.012},
    "figure_6": {"*": 0.01},
    "figure_8": {"curve/*": 3e-3, "curve/coefficients": 0.02},
    "figure_9": {
        "amplitude/predictive/low_rpm": 3e-3,
        "amplitude/predictive/high_rpm": 3e-3,
    },
    "figure_10": {"amplitude/curve/*": 3e-3},
}
"""Arrays that come of draws: tolerance as a share of their largest value."""


NOT_YET = {
    name
    for name in ("calibration_main", "calibration", "calibration_ranks", "hidden_effects")
    if not (TABLES / f"{name}.csv").is_file()
}
"""Tables of the long studies, where they were not run yet."""

DRAWN = [name for name in FIGURES if f"{name}_ranks" not in NOT_YET]
"""Figures whose tables are there."""

DIMENSIONLESS = {
    "Date", "Probability", "Hidden", "Named first", "rank", "RMS / noise floor",
    "Share of ranks below,\nless uniform", "Posterior sd / Cramér-Rao bound",
    "Share of pairs in which wear is reported",
}  # fmt: skip
"""Names of axes that have no unit."""


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """The quick experiments, small, with the committed tables."""
    return common.Stored(make(tmp_path_factory.mktemp("paper")), TABLES)


@pytest.fixture(scope="module")
def shown(stored):
    """The arrays of every figure."""
    return {name: FIGURES[name].data(stored) for name in DRAWN}


def lines(name: str) -> list[dict[str, str]]:
    """A committed table."""
    with (TABLES / f"{name}.csv").open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def tolerance(figure: str, path: str, golden: dict, values: np.ndarray) -> float:
    """How far an array may be from its golden, in its own unit."""
    if set(golden["sizes"]) & set(SAMPLED):
        quantiles = values.reshape(3, -1)
        return OF_TAILS.get(path, MONTE_CARLO) * float(np.nanmax(quantiles[2] - quantiles[0]))
    rules = OF_DRAWS.get(figure, {})
    group = f"{path.rpartition('/')[0]}/*"
    share = rules.get(path, rules.get(group, rules.get("*", EXACT)))
    return share * float(np.nanmax(np.abs(values)))


# The golden test


@pytest.mark.parametrize("name", [n for n in FIGURES if n not in FROM_TABLES])
def test_the_arrays_of_a_figure_are_those_of_its_golden(shown, name):
    goldens = json.loads(GOLDEN.read_text(encoding="utf-8"))[name]
    found = described(shown[name])
    assert set(found) == set(goldens), "python tests/support/paper_results.py makes goldens anew"
    for path, golden in goldens.items():
        assert found[path]["units"] == golden["units"], path
        old, new = (np.array(part["values"], dtype=float) for part in (golden, found[path]))
        assert np.array_equal(np.isnan(old), np.isnan(new)), path
        if old.size and np.isfinite(old).any():
            apart = np.nanmax(np.abs(old - new))
            assert apart <= tolerance(name, path, golden, old), f"{path} moved by {apart:.3g}"


def test_a_golden_notices_a_moved_array(shown):
    """The golden test can fail: 1 % more on one array is more than it lets pass."""
    golden = json.loads(GOLDEN.read_text(encoding="utf-8"))["figure_3"]["train_rpm"]
    old = np.array(golden["values"])
    moved = np.array(described(1.01 * shown["figure_3"])["train_rpm"]["values"])
    assert np.abs(moved - old).max() > tolerance("figure_3", "train_rpm", golden, old)


# Figures of committed tables show what these hold


def test_detection_curves_are_those_of_the_table(shown):
    found = shown["wear_detection"]
    for row, line in zip(found["row"].values, lines("wear_detection"), strict=True):
        part = found.sel(row=row)
        assert row == line["name"]
        assert part["reported"].dropna("change").values.tolist() == [
            float(x) for x in line["reported"].split()
        ]
        assert float(part["smallest_mrad"]) == float(line["smallest_mrad"])


def test_efficiency_is_that_of_the_table_and_the_bound_is_a_bound(shown):
    found, table = shown["efficiency"], lines("efficiency")
    by_gap = found.swap_dims(gap="gap_mrad").set_coords("gap_mrad")
    assert found.sizes["gap"] == len(table)
    for line in table:
        part = by_gap.sel(gap_mrad=float(line["gap_mrad"]))
        for way in found["way"].values:
            assert float(part["sd_percent"].sel(way=way)) == float(line[f"{way}_sd_%"])
    # A median over 16 recordings of a posterior sd scatters by about 1 %.
    assert float(found["over_bound"].min()) > 0.95


def test_errors_of_foreign_estimators_are_those_of_the_table(shown):
    found = shown["shared_estimator"]
    for line in lines("estimator_mismatch"):
        part = found.sel(noise=line["name"])
        for name in found["estimator"].values:
            expected = [float(x) for x in line[f"{name}_%"].split()]
            assert part["error_percent"].sel(estimator=name).values.tolist() == expected
    own = found.sel(estimator="same")
    # 14 means, each within three standard errors of none but for one case in 25.
    assert np.all(np.abs(own["error_percent"]) < 4.5 * own["standard_error_percent"].clip(min=0.25))


def test_the_confusion_matrix_counts_every_single_thing_hidden_once(shown):
    module = importlib.import_module("confusion")
    found = shown["confusion"]
    name = next(t for t in module.TABLES if (TABLES / f"{t}.csv").is_file())
    single = [line for line in lines(name) if " + " not in line["hidden"]]
    counted = sum(int(v) for line in single for k, v in line.items() if v.isdigit())
    assert int(found["count"].sum()) == counted
    assert set(found["hidden"].values) == {line["hidden"] or line["row"] for line in single}
    assert np.all(found["right"].sum("answer") == 1), "each row has one right answer"


def test_the_whole_study_is_taken_where_it_is_there(tmp_path):
    module = importlib.import_module("confusion")
    known = EFFECTS[0].name
    for table, answer in zip(module.TABLES, (known, "unexplained"), strict=True):
        text = f"row,hidden,{answer}\none effect,{known},2\n"
        (tmp_path / f"{table}.csv").write_text(text)
    found = module.data(common.Stored(tmp_path, tmp_path))
    assert int(found["count"].sel(hidden=known, answer=known)) == 2


def test_widths_of_the_change_are_those_of_the_table(shown):
    (line,) = lines("shared_curve")
    widths = shown["shared_curve"]["width_mrad"]
    for way, column in (("shared", "shared_width_mrad"), ("independent", "apart_width_mrad")):
        assert widths.sel(way=way).values.tolist() == [float(x) for x in line[column].split()]
    # Where nothing changed all of the bench cancels.
    assert float(widths.sel(way="shared")[0]) < 0.8 * float(widths.sel(way="independent")[0])


def test_calibration_draws_from_tables_what_its_study_draws_from_cases(tmp_path):
    """Counts in hundredths are all that ranks are asked for."""
    module = importlib.import_module("calibration")
    generator = np.random.default_rng(5)
    table, cases = [], {}
    for row, power in (("exact", 1.0), ("biased", 1.5)):
        ranks = generator.uniform(size=200) ** power
        cases[row] = xr.Dataset(
            {
                "delta_rank": ("case", ranks),
                "delta_error": ("case", generator.normal(size=200)),
                "delta_sd": ("case", np.ones(200)),
                "withheld": ("case", np.zeros(200)),
            }
        )
        line = calibration_line("delta", cases[row], from_prior=True)
        table.append({"name": row, "cases": 200, "failed": 0, **line})
    counts = [
        {"row": row, "quantity": "delta",
         "counts": " ".join(map(str, module.rank_counts(part["delta_rank"].values)))}
        for row, part in cases.items()
    ]  # fmt: skip
    for name, content in (
        ("calibration_main", table[:1]), ("calibration", table[1:]), ("calibration_ranks", counts)
    ):  # fmt: skip
        with (tmp_path / f"{name}.csv").open("w", encoding="utf-8", newline="") as stream:
            writer = csv.DictWriter(stream, list(content[0]))
            writer.writeheader()
            writer.writerows(content)
    found = module.data(common.Stored(tmp_path, tmp_path))
    ours, theirs = module.draw(found), draw_calibration(table, cases, ["delta"])
    for panel, expected in zip(ours.axes, theirs.axes, strict=True):
        assert len(panel.lines) == len(expected.lines)
        for line, other in zip(panel.lines, expected.lines, strict=True):
            assert np.allclose(line.get_xydata(), other.get_xydata(), atol=1e-5)
            assert line.get_label() == other.get_label() or other.get_label().startswith("_")
    assert "in 1 of 2" in module.caption(found)


# What is drawn


@pytest.mark.parametrize("name", DRAWN)
def test_a_figure_is_written_with_a_caption_and_embedded_fonts(stored, name, tmp_path):
    pdf, png, caption = FIGURES[name].write(stored, tmp_path)
    assert b"/FontFile2" in pdf.read_bytes(), "TrueType, embedded"
    assert b"/Type3" not in pdf.read_bytes()
    assert png.stat().st_size > 0
    told = caption.read_text(encoding="utf-8")
    assert told.rstrip().endswith((".", "%."))
    assert "nan" not in told.lower().split()


def written(figure: Figure) -> list[Text]:
    """Every text that a reader sees; ticks beyond the axes have labels that are never drawn."""
    found = [text for legend in figure.legends for text in legend.get_texts()]
    for panel in figure.axes:
        legend = panel.get_legend()
        found += legend.get_texts() if legend else []
        found += [panel.title, panel._left_title, *panel.texts]
        for axis in (panel.xaxis, panel.yaxis):
            if not axis.get_visible():
                continue
            low, high = sorted(axis.get_view_interval())
            slack = 1e-6 * (high - low)
            found.append(axis.label)
            for tick in axis.get_major_ticks():
                if low - slack <= tick.get_loc() <= high + slack:
                    found += [t for t in (tick.label1, tick.label2) if t.get_visible()]
    return [text for text in found if text.get_visible() and text.get_text().strip()]


@pytest.mark.parametrize("name", DRAWN)
def test_text_can_be_read_at_printed_size(shown, name):
    """A journal's column widths, no letter below 7 pt, none off the page or on another."""
    with publication_style():
        figure = FIGURES[name].draw(shown[name])
        figure.canvas.draw()
        texts = written(figure)
        boxes = [text.get_window_extent() for text in texts]
    assert figure.get_size_inches()[0] in (3.4, 7.0)
    assert min(text.get_fontsize() for text in texts) >= 7.0
    for index, (text, box) in enumerate(zip(texts, boxes, strict=True)):
        inside = figure.bbox.padded(1.0)
        assert inside.contains(box.x0, box.y0), f"off the page: {text.get_text()}"
        assert inside.contains(box.x1, box.y1), f"off the page: {text.get_text()}"
        for other, its_box in zip(texts[:index], boxes[:index], strict=True):
            common_part = Bbox.intersection(box.padded(-1.5), its_box.padded(-1.5))
            assert common_part is None, f"{text.get_text()} lies on {other.get_text()}"


@pytest.mark.parametrize("name", DRAWN)
def test_every_axis_with_numbers_says_what_they_are(shown, name):
    """Along the bottom and the left of a figure; panels that share an axis share its name."""
    with publication_style():
        panels = FIGURES[name].draw(shown[name]).axes
    labels = [(panel.get_xlabel(), panel.get_ylabel()) for panel in panels]
    assert any(x for x, _ in labels)
    for x, y in labels:
        for label in filter(None, (x, y)):
            known = "(" in label or label in DIMENSIONLESS
            assert known, f"no unit in {label}"


def test_every_script_is_made_by_make_all_and_every_figure_named_after_its_script():
    scripts = {p.stem for p in SCRIPTS.glob("*.py")} - {"common", "make_all"}
    assert scripts == set(make_all.NAMES) == set(FIGURES)


def test_every_result_and_study_has_its_configuration():
    configs = [c for made in common.RESULTS.values() for c in made.configs]
    for config in [*configs, *common.STUDIES.values()]:
        assert (ROOT / config).is_file(), config
    for name in common.STUDIES.keys() - NOT_YET:
        assert (TABLES / f"{name}.csv").is_file(), name


# Single figures


def test_the_simulated_recording_is_laid_where_the_recorded_one_lies(stored):
    figure_6 = importlib.import_module("figure_6")
    snapshot = snapshots(stored.tree("wear_swept"))[0]
    time, _ = figure_6.recorded_channels(snapshot)
    for angle in (0.1, 3.3):
        made = stored.bench.simulate(7e-4, rotations=1.2, sampling_hz=1000.0, start_angle_rad=angle)
        found = figure_6.simulated_like(stored.bench, 7e-4, made.time_s, dict(made.channels))
        turn = (found.metadata["start_angle_rad"] - angle + np.pi) % (2.0 * np.pi) - np.pi
        assert abs(turn) < 1e-3
    assert time[0] == 0.0


def test_the_variable_stiffness_is_that_of_the_shaft_outside_the_gap_and_none_inside():
    stiffness = importlib.import_module("figure_5").variable_stiffness
    twist = np.array([-3e-3, -1e-3, 0.0, 1e-3, 3e-3])
    found = stiffness(twist, 1e-3, 1.2e5, 1e6)
    assert found / 1.2e5 == pytest.approx([1.0, 0.5, 0.0, 0.5, 1.0], abs=2e-3)


def test_shares_of_a_budget_are_whole(shown):
    assert shown["uncertainty_budget"]["share"].sum("source").values == pytest.approx(1.0)


def test_a_missing_result_is_told_with_its_command(tmp_path, capsys):
    stored = common.Stored(tmp_path, tmp_path)
    chosen = [FIGURES[name] for name in ("figure_7", "efficiency")]
    assert common.write_all(chosen, stored, tmp_path) == 2
    told = capsys.readouterr().err
    assert "bayesbl run configs/sweep.toml" in told
    assert "bayesbl run configs/efficiency.toml" in told


def test_a_script_runs_by_itself(tmp_path):
    command = [sys.executable, str(SCRIPTS / "efficiency.py"), "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, check=True)
    assert (tmp_path / "efficiency.pdf").is_file(), done.stderr


def test_arrays_keep_their_units(shown):
    for name, content in shown.items():
        tree = xr.DataTree(content) if isinstance(content, xr.Dataset) else content
        for node in tree.subtree:
            for variable in node.to_dataset(inherit=False).data_vars.values():
                if variable.dtype.kind == "f":
                    assert "units" in variable.attrs, f"{name}: {variable.name}"
