"""Laws of the page: the answer first, all of it inside one file, nothing of a user's text alive."""

from __future__ import annotations

import base64
import io
import json
import re
from datetime import date
from html.parser import HTMLParser
from pathlib import Path

import matplotlib.image as mpimg
import numpy as np
import pytest
import xarray as xr
from places import CONFIGS, RECORDINGS
from quick import without_figures
from stored_measurement import judged

import bayesbl
from bayesbl import cli
from bayesbl.config.sections import Interval as IntervalConfig
from bayesbl.measurement.wear import DATES, summarise_wear, years_between
from bayesbl.measurement.wear import wear as wear_in_time
from bayesbl.presentation import answer, words
from bayesbl.presentation import wear as worn
from bayesbl.presentation.answer import NOT_SHOWN
from bayesbl.presentation.console import SUBJECTS
from bayesbl.presentation.page.build import page, prose
from bayesbl.presentation.result_object import result_of
from bayesbl.results.store import read_tree, write_tree
from bayesbl.results.variables import dataset
from bayesbl.runs.kinds import summarise

HOSTILE = "<script>alert('δ')</script> & \"July\""
CONFIG_OF_A_LOST_STUDY = 'schema = 1\nkind = "study"\nstudy = "/gone/study.py"\n'
VOID = {"meta", "img", "br", "link", "input"}


class Reader(HTMLParser):
    """Tags and texts of a page; an end tag without its begin fails."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.open: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] != "style":
            self.texts.append(data)

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", " ".join(self.texts))


def require_closed(reader: Reader) -> None:
    """Every tag is ended, every address is a picture's data or a place that is there."""
    assert reader.open == []
    targets = {attributes["id"] for _, attributes in reader.tags if "id" in attributes}
    for _, attributes in reader.tags:
        for name in ("src", "href"):
            address = attributes.get(name)
            assert address is None or address.startswith("data:image/") or address[1:] in targets


def plain(text: str) -> str:
    return re.sub(r"\s+", " ", text)


@pytest.fixture(scope="module")
def compared(tmp_path_factory) -> Path:
    """The stored comparison of the two examples, without figures."""
    folder = tmp_path_factory.mktemp("compared")
    recordings = [str(RECORDINGS / f"wear_{name}.csv") for name in ("before", "after")]
    with without_figures():
        out = ["--out", str(folder / "out"), "--limit-rad", "1.2e-3", "--gear-ratio", "120"]
        out += ["--bench", str(CONFIGS / "bench.toml"), "--route", "amplitude"]
        assert cli.status(["compare", *recordings, *out]) == 0
    return folder / "out"


@pytest.fixture(scope="module")
def written(compared) -> str:
    """The page that the command writes, figures and all."""
    assert cli.status(["report", str(compared)]) == 0
    return (compared / "report.html").read_text(encoding="utf-8")


@pytest.fixture
def tree(compared) -> xr.DataTree:
    return read_tree(compared)


def hostile(tree: xr.DataTree) -> xr.DataTree:
    """The same result with markup in every text that a user may give."""
    old = str(tree["gap"].to_dataset()["snapshot"].values[-1])
    for node in tree.subtree:
        data = node.to_dataset(inherit=False)
        for name in ("snapshot", "step_from", "step_to"):
            if name in data:
                labels = [HOSTILE if str(v) == old else str(v) for v in data[name].values]
                data = (
                    data.assign_coords({name: (data[name].dims, labels)})
                    if (name in data.coords)
                    else data.assign({name: (data[name].dims, labels)})
                )
        node.dataset = data
    summary = json.loads(tree.attrs["summary"].replace(f'"{old}"', json.dumps(HOSTILE)))
    tree.attrs["summary"] = json.dumps(summary | {"warnings": [HOSTILE]})
    tree.attrs["recordings"] = [
        HOSTILE if name == old else name for name in tree.attrs["recordings"]
    ]
    tree.attrs["config"] += f"\n# {HOSTILE}"
    tree.attrs["input_sha256"] = json.dumps({f"{HOSTILE}.csv": "0" * 64})
    return tree


@pytest.mark.long
def test_a_page_needs_no_network_no_script_and_no_other_file(written):
    reader = Reader(written)
    require_closed(reader)
    assert not {tag for tag, _ in reader.tags} & {"script", "link", "iframe", "object"}
    style = re.search(r"<style>(.*?)</style>", written, re.S)[1]
    assert "url(" not in style
    assert "@import" not in style


def test_the_answer_stands_before_everything_else(tree):
    told = plain(Reader(page(tree, [])).text)
    summary = summarise(tree)
    places = [
        told.index(plain(words.glued(answer.headline(summary)))),
        told.index("No repair is due"),
    ]
    places.append(told.index("Figures" if "Figures" in told else "Numbers"))
    assert max(places[:2]) < places[2]


def test_the_page_says_what_the_terminal_says(tree, compared, capsys):
    """Every number of ``inspect`` stands in the page."""
    assert cli.status(["inspect", str(compared)]) == 0
    printed = capsys.readouterr().out
    told = Reader(page(tree, [])).text
    numbers = set(re.findall(r"\d+\.\d+(?:e[-+]\d+)?|[0-9a-f]{64}", printed))
    assert len(numbers) > 30
    assert numbers - set(re.findall(r"\d+\.\d+(?:e[-+]\d+)?|[0-9a-f]{64}", told)) == set()


def test_every_section_is_there(tree):
    ids = {attributes.get("id") for _, attributes in Reader(page(tree, [])).tags}
    assert ids >= {
        "numbers",
        "diagnostics",
        "assumptions",
        "config",
        "provenance",
        "cite",
    }


def test_a_withheld_gap_is_nowhere_on_the_page(tree):
    tree = judged(tree, "wear_before", "wear_after")
    told = Reader(page(tree, [])).text
    assert "Do not decide from these recordings." in told
    assert "The sampler did not converge." in told
    assert not re.search(r"\d mrad \(90", told)
    assert "+0.2" not in told


def test_every_picture_has_a_text_and_every_table_a_head(written):
    reader = Reader(written)
    pictures = [attributes for tag, attributes in reader.tags if tag == "img"]
    assert len(pictures) >= 3
    assert all(attributes["alt"] for attributes in pictures)
    tags = [tag for tag, _ in reader.tags]
    assert tags.count("thead") == tags.count("table") > 0
    assert all(a.get("scope") == "col" for tag, a in reader.tags if tag == "th")


def test_letters_of_all_figures_are_of_one_size(written):
    """Each figure says how wide it is drawn, so that one style shrinks all alike."""
    figures = re.findall(r'<img style="--pixels: (\d+)" src="data:image/png;base64,(.+?)"', written)
    assert figures
    for told, data in figures:
        assert mpimg.imread(io.BytesIO(base64.b64decode(data))).shape[1] == int(told)


def test_markup_in_a_users_text_stays_text(tree):
    text = page(hostile(tree), [])
    reader = Reader(text)
    assert "script" not in {tag for tag, _ in reader.tags}
    assert "<script" not in text
    assert reader.text.count("<script>alert('δ')</script>") >= 5


def test_a_study_with_a_hostile_row_is_shown(tmp_path):
    line = {"name": HOSTILE, "cases": 2, "failed": 1, "cover": 0.5, "commit": "abc"}
    row = xr.Dataset(
        {
            "failed": ("case", [0.0, 1.0]),
            "message": ("case", ["", HOSTILE]),
            "seconds": ("case", [1.0, 1.0]),
            "commit": ("case", ["abc", "abc"]),
        },
        {"case": [0, 1]},
        attrs={"name": HOSTILE, "line": json.dumps(line), "commit": "abc", "seconds": 2.0},
    )
    tree = xr.DataTree.from_dict({"row_1": row})
    summary = json.dumps({"study": "coverage", "rows": [line | {"seconds": 2.0}]})
    tree.attrs = {"kind": "study", "summary": summary, "outcome": "done"}
    tree.attrs |= {"bayesbl_version": "1", "git_commit": "abc", "seed": 1}
    tree.attrs |= {"config": CONFIG_OF_A_LOST_STUDY, "input_sha256": "{}"}
    write_tree(tree, tmp_path / "result.nc")
    assert cli.status(["report", str(tmp_path)]) == 0
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<script" not in text
    require_closed(Reader(text))
    assert "Study coverage: 2 cases in 1 rows." in plain(Reader(text).text)
    assert "1 case failed" in Reader(text).text


def test_what_is_no_result_is_refused(tmp_path, capsys):
    assert cli.status(["report", str(tmp_path)]) == cli.WRONG
    assert "no such result" in capsys.readouterr().err


# Advice


def advice(summary):
    return SUBJECTS[summary["kind"]].advice(summary)


def fitted(delta=(6e-4, 8e-4), above=None, limit=None):
    interval = {"median": sum(delta) / 2, "low": delta[0], "high": delta[1], "level": 0.9,
                "kind": "equal_tailed"} if delta else None  # fmt: skip
    told = {"code": "sampling", "text": "The sampler did not converge."}
    part = {"kind": "fit", "outcome": "converged", "route": "amplitude"}
    part |= {"delta_rad": interval, "curve": "results/sweep/result.nc", "rmse_rpm": 1.8}
    part |= {"delta_upper_bound_rad": None, "reason": None if delta else told}
    part |= {"diagnostics": {"reasons": [] if delta else [{**told, "withholds": True}]}}
    part |= {"routes": {"amplitude": part.copy()}}
    return part | ({"limit_rad": limit, "probability_above_limit": above} if limit else {})


@pytest.mark.parametrize(
    ("above", "tone"), [(1.0, "act"), (0.96, "act"), (0.5, "watch"), (0.04, "fine"), (0.0, "fine")]
)
def test_repair_is_advised_by_the_probability_above_the_limit(above, tone):
    given = advice(fitted(above=above, limit=1e-3))
    assert given.tone == tone
    assert words.probability(above) in given.sentences[0]


def test_no_advice_is_given_on_a_withheld_gap():
    given = advice(fitted(delta=None, above=None, limit=1e-3))
    assert given.tone == "withheld"
    assert "The sampler did not converge." in given.sentences


def test_the_advice_says_whose_curve_it_rests_on():
    own, published = fitted(), fitted() | {"curve": "published"}
    assert not any("paper" in sentence for sentence in advice(own).sentences)
    assert any("paper" in sentence for sentence in advice(published).sentences)


def test_no_all_clear_is_given_by_the_curve_of_another_machine():
    own = fitted(above=0.0, limit=1e-3)
    published = advice(own | {"curve": "published"})
    assert advice(own).tone == "fine"
    assert published.tone == "note"
    assert "another machine" in published.title
    simulated = {key: value for key, value in own.items() if key != "rmse_rpm"}
    assert advice(simulated | {"curve": None, "route": "direct"}).tone == "fine"


def compared_undated(change, above, limit=1.2e-3, spots=()):
    low, high = change
    middle = 0.5 * (low + high)
    part = fitted(above=above, limit=limit) | {"name": "new", "budget": {"noise": 1.0}}
    found = {"median": middle, "low": low, "high": high, "level": 0.9, "kind": "equal_tailed"}
    return {"kind": "compare", "outcome": "converged", "snapshots": [part], "change_rad": found,
            "curve": "sweep", "probability_increase": 0.99, "reason": None,
            "same_joint": {"blind_spots": list(spots)},
            "wear": None}  # fmt: skip


@pytest.mark.parametrize("change", [(1e-4, 3e-4), (-3e-4, -1e-4)])
def test_what_something_else_could_have_done_is_no_wear_and_no_repair(change):
    spot = {"code": "parameter_unseen", "text": "payload by 3 %", "delta_error_rad": 2e-4}
    given = advice(compared_undated(change, None, None, [spot]))
    assert given.title == NOT_SHOWN
    told = " ".join(given.sentences)
    assert "not shown to have changed" in told
    assert answer.SHRANK not in told


@pytest.mark.parametrize("limit", [1.2e-3, None])
def test_a_gap_that_shrank_without_dates_is_no_all_clear(limit):
    given = advice(compared_undated((-3e-4, -1e-4), 0.0, limit))
    assert given.tone == "watch"
    assert answer.SHRANK in given.sentences


@pytest.mark.parametrize("verdict", ["named", "parameter_error"])
def test_a_diagnosis_that_found_something_is_no_alarm(verdict):
    assert advice(diagnosed_summary(verdict)).tone == "note"


@pytest.mark.parametrize("verdict", ["nothing_missing", "parameter_error", "unexplained", "named"])
def test_every_verdict_has_its_advice(verdict):
    effects = [{"name": "load_coulomb_friction"}] if verdict == "named" else []
    given = advice(
        {
            "kind": "diagnose",
            "verdict": verdict,
            "effects": effects,
            "parameter_errors": [],
        }
    )
    assert given.title
    assert ("load Coulomb friction" in " ".join(given.sentences)) == (verdict == "named")


def dated(rate=(2e-4, 4e-4), certain=0.999, before=None, years=(1.0, 3.0), limit=1.2e-3, count=3):
    """The summary of a dated comparison, as far as page and advice read it."""

    def interval(low, high):
        middle = 0.5 * (low + high)
        return {"median": middle, "low": low, "high": high, "level": 0.9, "kind": "equal_tailed"}

    part = fitted(above=1e-3, limit=limit)
    days = {"median": "2028-03-02", "low": "2027-01-05", "high": "2029-02-03"}
    wear = {
        "snapshots": [f"s{i}" for i in range(count)],
        "first_date": "2025-01-01",
        "last_date": "2026-01-01",
        "level": 0.9,
        "probability_wear": certain,
        "law": {"steady": 0.5, "speeding_up": 0.4, "slowing": 0.1},
        "rate": interval(*rate),
        "rate_at_most_rad_per_year": 0.95 * rate[1],
        "limit_rad": limit,
        "limit": None,
        "forecast_from_prior": None,
        "drift_widens": None,
        "years_to_limit": interval(*years) if limit else None,
        "date_of_limit": days if limit else None,
        "not_before": {"date": "2027-02-01", "level": 0.9} if limit else None,
        "decide_before": None if before is None else "2027-06-01",
        "probability_before": (
            None if before is None else {"date": "2027-06-01", "probability": before}
        ),
        "reason": None,
    }
    snapshots = [{**part, "name": name, "budget": {"noise": 1.0}} for name in wear["snapshots"]]
    change = interval(1e-4, 3e-4)
    return {
        "kind": "compare",
        "outcome": "converged",
        "snapshots": snapshots,
        "change_rad": change,
        "probability_increase": 0.999,
        "same_joint": {"blind_spots": []},
        "wear": wear,
        "curve": "sweep",
        "reason": None,
    }


@pytest.mark.parametrize(("before", "tone"), [(None, "fine"), (0.01, "fine"), (0.4, "watch")])
def test_dated_snapshots_are_advised_by_when_the_limit_is_reached(before, tone):
    given = advice(dated(before=before))
    assert given.tone == tone
    assert "2027-02-01" in given.title, "the one-sided answer is the one to plan by"
    assert (before is not None) == any("2027-06-01" in told for told in given.sentences)


def test_no_date_is_planned_by_where_no_wear_is_shown():
    given = advice(dated(certain=0.6, before=0.4))
    assert given.tone == "fine"
    assert "2027" not in given.title


def test_a_joint_beyond_its_limit_is_due_whatever_the_forecast():
    summary = dated()
    summary["snapshots"][-1]["probability_above_limit"] = 0.99
    assert advice(summary).title == "The joint is due for repair."


def test_without_a_limit_the_rate_is_told_and_without_a_rate_why():
    assert "a year" in " ".join(advice(dated(limit=None)).sentences)
    assert "No wear is shown" in advice(dated(limit=None, certain=0.6)).title
    healed = dated()
    text = "The gap shrank: was the joint repaired?"
    healed["wear"] |= {"reason": {"code": "gap_shrank", "text": text}}
    assert "The gap shrank: was the joint repaired?" in advice(healed).sentences


def test_the_headline_of_dated_snapshots_claims_growth_only_where_it_is_shown():
    assert "has grown by 0.30 mrad a year" in next(answer.lead(dated()))
    assert "not shown to have grown" in next(answer.lead(dated(certain=0.9)))


def test_dated_snapshots_lead_with_their_wear_and_never_with_a_change_across_a_repair():
    steady, repaired, untold = dated(), dated(), dated()
    of_wear = worn.headline(steady, steady["wear"])
    assert list(answer.lead(steady)) == [of_wear, answer.in_words(steady)]
    repaired["snapshots"].insert(0, {**repaired["snapshots"][0], "name": "worn"})
    assert list(answer.lead(repaired)) == [of_wear]
    untold["wear"] |= {"reason": {"code": "one_date", "text": "There is only one snapshot."}}
    assert list(answer.lead(untold)) == [answer.in_words(untold)]


def test_two_snapshots_are_told_to_be_few():
    assert any("Take a third" in told for told in worn.notes(dated(count=2)["wear"]))
    assert not any("Take a third" in told for told in worn.notes(dated(count=3)["wear"]))


def test_the_page_of_dated_snapshots_has_gap_rate_and_date_before_anything_else(tree):
    days = [date(2026, 3, 1), date(2026, 7, 1)]
    summary = json.loads(tree.attrs["summary"])
    names = [part["name"] for part in summary["snapshots"]]
    gaps = tree["gap"]["delta_rad"].values
    years = np.array([years_between(days[0], day) for day in days])
    found = wear_in_time(gaps, years, np.random.SeedSequence(1), limit_rad=1.2e-3)
    dates = dataset(DATES, {"date": [day.isoformat() for day in days], "used": [1.0, 1.0]})
    group = dates.merge(found)
    tree["wear"] = xr.DataTree(group)
    wear = summarise_wear(group, names, IntervalConfig(), 1.2e-3)
    tree.attrs["summary"] = json.dumps(summary | {"wear": {**wear, "reason": None}})
    told = plain(Reader(page(tree, [])).text)
    first = told[: told.index("Numbers")]
    for expected in (
        words.middle(wear["rate"], 1e3),
        "mrad a year",
        wear["not_before"]["date"],
        "Plan the repair",
    ):
        assert expected in first, expected
    assert told.count("With 90 % probability the gap does not reach") == 1, "never said twice"


def diagnosed_summary(verdict, alike=(), bench=True):
    effect = {"name": "load_coulomb_friction", "indistinguishable_from": list(alike)}
    return {
        "kind": "diagnose",
        "verdict": verdict,
        "effects": [effect] if verdict == "named" else [],
        "parameter_errors": [],
        **({"augmented_bench": "augmented_bench.toml"} if bench else {}),
        "suggested_recording": None,
    }


@pytest.mark.parametrize("verdict", ["named", "parameter_error"])
def test_the_bench_that_a_diagnosis_wrote_is_the_one_to_go_on_with(verdict):
    told = advice(diagnosed_summary(verdict))
    assert "augmented_bench.toml" in told.title
    assert "--bench augmented_bench.toml" in " ".join(told.sentences)
    other = advice(diagnosed_summary(verdict, bench=False))
    assert "augmented_bench" not in other.title, "a rigid bench's diagnosis writes none"


@pytest.mark.parametrize("verdict", ["named", "parameter_error"])
def test_a_bench_whose_edges_decide_the_gap_is_not_one_to_go_on_with(verdict):
    told = advice(diagnosed_summary(verdict) | {"gap_withheld": "δ depends on a tolerance."})
    assert "Correct the bench" in told.title
    assert "augmented_bench" not in " ".join((told.title, *told.sentences))


def test_a_set_that_cannot_be_told_apart_is_not_taken_for_one_effect():
    sure, unsure = (
        " ".join(advice(diagnosed_summary("named", alike)).sentences)
        for alike in ((), ("motor_coulomb_friction",))
    )
    assert "separate all effects" in unsure
    assert "apart" not in sure


# Figures


def test_a_result_as_an_object_says_what_the_command_prints_and_the_page_shows(
    compared, written, capsys
):
    result = bayesbl.read_result(compared)
    assert cli.status(["inspect", str(compared)]) == 0
    assert capsys.readouterr().out.startswith(str(result))
    shown = Reader(result._repr_html_())
    assert shown.open == []
    texts = {text.strip() for text in Reader(written).texts}
    assert [text for text in shown.texts if text.strip() not in texts] == []
    rows = result.to_dataframe()
    change = result["change"].to_dataset()["change_rad"]
    assert result["change/change_rad"].identical(change)
    assert result.attrs["kind"] == "compare"
    assert list(rows["name"]) == ["wear_before", "wear_after"]
    assert rows["delta_rad"].diff().iloc[-1] == pytest.approx(float(change.median()), abs=1e-5)
    assert list(rows["delta_rad_low"]) == [
        snapshot["delta_rad"]["low"] for snapshot in result.summary["snapshots"]
    ]


def test_every_figure_of_a_result_is_a_method_of_it(compared):
    plot = bayesbl.read_result(compared).plot
    assert {"gap", "signal"} <= set(dir(plot))
    assert plot.signal().axes
    with pytest.raises(bayesbl.UserError, match='Did you mean "gap"'):
        plot("gapp")
    with pytest.raises(bayesbl.UserError, match="it shows the whole result"):
        plot.signal("wear_later")
    with pytest.raises(AttributeError, match="gapp"):
        _ = plot.gapp


def test_a_notebook_shows_names_of_others_as_text(tree):
    html = result_of(hostile(tree))._repr_html_()
    assert HOSTILE not in html
    assert Reader(html).open == []


def test_commands_are_code_and_no_option_is_broken_or_brings_markup():
    assert str(prose("Then `bayesbl fit A --bench <b>`; (--limit-rad) a--b")) == (
        'Then <code>bayesbl fit A <span class="option">--bench</span> &lt;b&gt;</code>; '
        '(<span class="option">--limit-rad</span>) a--b'
    )
