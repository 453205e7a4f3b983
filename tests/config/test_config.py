"""Configurations: what they mean, and every way to get one wrong said in one message."""

from __future__ import annotations

import re
from datetime import date
from operator import attrgetter
from pathlib import Path

import pytest
from fresh_process import loaded_by
from places import BEFORE, CONFIGS
from pydantic import ValidationError

from bayesbl.config.kinds import StudyConfig
from bayesbl.config.loading import OPTIONS, config_from_options, dump_config, load_config
from bayesbl.config.measurement import CompareConfig, FitConfig, SnapshotConfig
from bayesbl.errors import ConfigError
from bayesbl.measurement.measurement import estimator_of
from bayesbl.recording.channels import ColumnSpec

COMPARE = """schema = 1
kind = "compare"
[[recordings]]
file = "before.csv"
[[recordings]]
file = "after.csv"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("before.csv", "after.csv", "bench.toml", "study.py", "curve.nc"):
        (tmp_path / name).touch()
    return tmp_path


def write(folder: Path, text: str, name: str = "config.toml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def load(folder: Path, extra: str = "", base: str = COMPARE) -> CompareConfig:
    config = load_config(write(folder, base + extra))
    assert isinstance(config, CompareConfig)
    return config


@pytest.mark.parametrize("name", ["wear_snapshots.toml", "fit_example.toml"])
def test_the_shipped_configurations_load(name: str) -> None:
    config = load_config(CONFIGS / name)
    assert isinstance(config, SnapshotConfig)
    assert config.recordings[0].name == "before"
    assert config.run.output.parent == CONFIGS.parent / "results"


def test_the_shipped_fit_writes_out_exactly_the_defaults(folder: Path) -> None:
    written = load_config(CONFIGS / "fit_example.toml")
    bare = config_from_options("fit", [BEFORE], bench=CONFIGS / "bench.toml")
    assert isinstance(written, FitConfig)
    assert isinstance(bare, FitConfig)
    for section in ("estimator", "posterior", "interval", "curve"):
        assert getattr(written, section) == getattr(bare, section)
    assert written.run.seed == bare.run.seed


def test_defaults_are_the_papers_model_with_a_baseline(folder: Path) -> None:
    config = load(folder)
    assert config.run.seed == 1
    assert config.estimator.model.fixed == {"window_start_s": 0.0, "window_end_s": 0.204}
    assert config.estimator.model.baseline_harmonics == 1
    assert config.estimator.noise.kind == "auto"
    assert config.interval.level == 0.9
    assert config.curve.source is None  # no gap without a bench or a curve that was named
    assert config.estimator.route == "amplitude"
    assert [recording.name for recording in config.recordings] == ["before", "after"]


def test_with_a_bench_both_routes_are_run_unless_one_is_named(folder: Path) -> None:
    bench = '[estimator]\nbench = "before.csv"\n'
    assert load(folder, bench).estimator.route == "auto"
    for route in ("amplitude", "direct", "auto"):
        assert load(folder, f'{bench}route = "{route}"\n').estimator.route == route


def test_every_kind_of_noise_can_be_asked_for(folder: Path) -> None:
    for kind in ("auto", "white", "ar", "student_t"):
        config = load(folder, f'[estimator.noise]\nkind = "{kind}"\n')
        assert estimator_of(config).noise_kind == kind


def test_paths_start_from_the_folder_of_the_configuration(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir("/")
    config = load(folder, '[run]\noutput = "../out"\n[curve]\nsource = "curve.nc"\n')
    assert config.recordings[0].file == folder / "before.csv"
    assert config.run.output == folder.parent / "out"
    assert config.curve.source == folder / "curve.nc"


def test_columns_may_be_named_with_a_unit_or_without(folder: Path) -> None:
    config = load(
        folder, '[columns]\nmotor_speed_rpm = "Speed"\ntime_s = {name = "t", unit = "ms"}\n'
    )
    assert config.column_specs == {
        "motor_speed_rpm": ColumnSpec("Speed"),
        "time_s": ColumnSpec("t", "ms"),
    }


FULL = """
[run]
seed = 7
workers = 3
output = "out"
[joint]
gear_ratio = 120
limit_rad = 1e-3
[columns]
motor_speed_rpm = "Speed [rpm]"
[estimator]
route = "amplitude"
bench = "bench.toml"
[estimator.model]
baseline_harmonics = 2
fixed = {start_time_s = 0.1, window_end_s = 0.3}
ranges = {rotation_period_s = [3, 4.5]}
[estimator.noise]
kind = "ar"
order = 3
[posterior]
[interval]
level = 0.95
kind = "hdi"
[curve]
source = "curve.nc"
allow_extrapolation = true
"""


def test_a_configuration_as_it_ran_loads_back_to_the_same_one(folder: Path) -> None:
    dated = COMPARE.replace('"after.csv"', '"after.csv"\ndate = 2026-03-01\nrepaired = true')
    dated = dated.replace('"before.csv"', '"before.csv"\ndate = 2026-02-01')
    config = load(folder, FULL, dated)
    assert config.recordings[1].date == date(2026, 3, 1)
    assert load_config(write(folder, dump_config(config), "again.toml")) == config
    study = write(
        folder,
        'schema = 1\nkind = "study"\nstudy = "study.py"\n'
        '[[rows]]\nname = "a"\nsource = "bench.toml"\npairs = 500\nphi = [0.6, {a = 1e-4}]\n',
    )
    loaded = load_config(study)
    assert isinstance(loaded, StudyConfig)
    assert loaded.rows[0]["source"] == str(folder / "bench.toml")
    assert load_config(write(folder, dump_config(loaded), "again.toml")) == loaded


def test_configurations_cannot_be_changed(folder: Path) -> None:
    with pytest.raises(ValidationError, match="frozen"):
        load(folder).interval.level = 0.5  # type: ignore[misc]


WRONG = {
    "unknown key": ("[posterior]\nensembels = 4\n", 'Did you mean "ensembles"?', "[posterior] ens"),
    "unknown section": ("[posteriors]\n", 'Did you mean "posterior"?', "posteriors"),
    "level above one": ("[interval]\nlevel = 1.5\n", "less than 1", "[interval] level"),
    "level of zero": ("[interval]\nlevel = 0\n", "greater than 0", "[interval] level"),
    "limit below zero": ("[joint]\nlimit_rad = -1e-3\n", "greater than 0", "[joint] limit_rad"),
    "gear ratio of nothing": ("[joint]\ngear_ratio = 0\n", "greater than 0", "[joint] gear_ratio"),
    "not a number": ("[joint]\nlimit_rad = nan\n", "finite number", "[joint] limit_rad"),
    "text for a number": ('[interval]\nlevel = "0.9"\n', "Expected: a number", "[interval] level"),
    "one ensemble": ("[posterior]\nensembles = 1\n", "equal to 2", "[posterior] ensembles"),
    "half an ensemble": ("[posterior]\nensembles = 2.5\n", "a whole number", "[posterior] ens"),
    "negative seed": ("[run]\nseed = -1\n", "equal to 0", "[run] seed"),
    "no workers": ("[run]\nworkers = 0\n", "equal to 1", "[run] workers"),
    "a section that is no table": ("run = 3\n", "Expected: a table", "run"),
    "unknown choice": ('[interval]\nkind = "hpd"\n', "'equal_tailed' or 'hdi'", "[interval] kind"),
    "unknown symbol": (
        "[estimator.model]\nfixed = {window_start_s = 0.0, tau = 3.0}\n",
        "no such symbol",
        "[estimator.model] fixed.tau",
    ),
    "empty range": (
        "[estimator.model]\nranges = {decay_rate_per_s = [9.0, 5.0]}\n",
        "low < high",
        "[estimator.model] ranges.decay_rate_per_s",
    ),
    "range with one end": (
        "[estimator.model]\nranges = {decay_rate_per_s = [9.0]}\n",
        "required key is missing",
        "[estimator.model] ranges.decay_rate_per_s",
    ),
    "start and window start free": (
        "[estimator.model]\nfixed = {}\n",
        "only their sum enters the model",
        "[estimator.model] fixed",
    ),
    "empty window": (
        "[estimator.model]\nfixed = {window_start_s = 0.3, window_end_s = 0.2}\n",
        "later than window_start_s",
        "[estimator.model] fixed",
    ),
    "negative decay": (
        "[estimator.model]\nfixed = {window_start_s = 0.0, decay_rate_per_s = -1.0}\n",
        "greater than 0",
        "[estimator.model] fixed",
    ),
    "fixed and ranged": (
        "[estimator.model]\nranges = {window_end_s = [0.1, 0.3]}\n",
        "window_end_s cannot have a range while fixed",
        "[estimator.model]",
    ),
    "order without ar": ("[estimator.noise]\norder = 2\n", 'kind = "ar"', "[estimator.noise]"),
    "direct without bench": ('[estimator]\nroute = "direct"\n', "needs a bench", "[estimator]"),
    "auto without bench": ('[estimator]\nroute = "auto"\n', "needs a bench", "[estimator]"),
    "direct from an earlier result": (
        '[estimator]\nroute = "direct"\nbench = "before.csv"\n'
        '[estimator.search]\nstart_from = "after.csv"\n',
        'no use with route = "direct"',
        "[estimator.search]",
    ),
    "direct with a second sampler": (
        '[estimator]\nroute = "direct"\nbench = "before.csv"\n[posterior]\ncheck_sampler = true\n',
        'no use with route = "direct"',
        "[posterior]",
    ),
    "direct with a rangeless gap": (
        "[estimator]\ngap_rad = [1e-3, 1e-3]\n",
        "range is empty",
        "[estimator] gap_rad",
    ),
    "direct from a gap below zero": (
        "[estimator]\ngap_rad = [-1e-4, 1e-3]\n",
        "greater than or equal to 0",
        "[estimator] gap_rad",
    ),
    "paper with baseline": (
        '[estimator.search]\nmethod = "paper"\n',
        "baseline_harmonics = 0",
        "[estimator]",
    ),
    "paper from an earlier result": (
        '[estimator.search]\nmethod = "paper"\nstart_from = "before.csv"\n',
        "does not start from an earlier result",
        "[estimator.search]",
    ),
    "missing curve": ('[curve]\nsource = "none.nc"\n', "no such file", "[curve] source"),
    "unknown channel": ('[columns]\nmotor_sped_rpm = "a"\n', '"motor_speed_rpm"', "[columns]"),
    "unknown unit": (
        '[columns]\nmotor_speed_rpm = {name = "a", unit = "mph"}\n',
        "rpm or rad/s",
        "[columns]",
    ),
    "one column twice": (
        '[columns]\nmotor_speed_rpm = "a"\nmotor_current_a = "a"\n',
        "mapped to two channels",
        "[columns]",
    ),
    "a third recording that is missing": (
        '[[recordings]]\nfile = "none.csv"\n',
        "no such file",
        "[[recordings]] 3 file",
    ),
    "two recordings of one name": (
        '[[recordings]]\nfile = "after.csv"\n',
        "same name",
        "[[recordings]]",
    ),
    "recording without file": (
        '[[recordings]]\nname = "x"\n',
        'Expected: "file"',
        "[[recordings]] 3 file",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_value_is_refused_with_file_field_finding_and_expectation(
    folder: Path, case: str
) -> None:
    extra, words, where = WRONG[case]
    # A bare key must come before the first table.
    text = COMPARE + extra if extra.startswith("[") else extra + COMPARE
    path = write(folder, text)
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    error = caught.value
    assert error.file == str(path)
    assert error.where is not None
    assert where in error.where
    assert error.where.startswith("line ")
    assert words in str(error)
    assert error.expected


def test_all_problems_of_a_file_are_reported_at_once_in_the_order_of_its_lines(
    folder: Path,
) -> None:
    extra = '[interval]\nlevel = 2\nknd = "hdi"\n[joint]\nlimit_rad = -1\n[run]\nseed = "x"\n'
    with pytest.raises(ConfigError) as caught:
        load(folder, extra)
    lines = str(caught.value).splitlines()
    assert "4 problems" in lines[0]
    assert [line.split(",")[0] for line in lines[1:]] == [
        "  line 8",
        "  line 9",
        "  line 11",
        "  line 13",
    ]


@pytest.mark.parametrize(
    ("text", "where", "words"),
    [
        ("schema = 1\nkind = compare\n", "line 2, column 8", "not valid TOML"),
        ("schema = 1\nschema = 1\n", "line 2", "not valid TOML"),
        ("x = " + "[" * 5000, None, "TOML|nested"),
        ("", "kind", "kind of run is missing"),
        ('schema = 1\nkind = "compair"\n', "line 2, kind", 'Did you mean "compare"'),
        (COMPARE.replace("schema = 1\n", ""), "schema", "required key is missing"),
        (COMPARE.replace("schema = 1", "schema = 2"), "line 1, schema", "Found: 2. Expected: 1"),
        (COMPARE.replace('"compare"', '"fit"'), "line 3, [[recordings]]", "exactly 1"),
        ('schema = 1\nkind = "study"\nstudy = "study.py"\nrows = []\n', "line 4", "needs rows"),
    ],
)
def test_a_file_that_is_no_configuration_is_refused(
    folder: Path, text: str, where: str | None, words: str
) -> None:
    path = write(folder, text)
    with pytest.raises(ConfigError, match=words) as caught:
        load_config(path)
    assert caught.value.file == str(path)
    assert caught.value.expected
    if where is not None:
        assert caught.value.where is not None
        assert caught.value.where.startswith(where)


def test_a_missing_a_binary_and_a_folder_configuration_are_refused(folder: Path) -> None:
    (folder / "binary.toml").write_bytes(b"\xff\xfe\x00")
    for name, words in (("none.toml", "no such file"), ("binary.toml", "text"), (".", "read")):
        with pytest.raises(ConfigError, match=words) as caught:
            load_config(folder / name)
        assert caught.value.file == str(folder / name)


def test_a_configuration_of_another_kind_than_the_command_is_refused(folder: Path) -> None:
    with pytest.raises(ConfigError, match=r'another kind.*"compare".*"fit"'):
        load_config(write(folder, COMPARE), kind="fit")


def test_a_byte_order_mark_does_no_harm(folder: Path) -> None:
    assert load_config(write(folder, "\ufeff" + COMPARE)) == load(folder)


def test_options_alone_make_the_configuration_that_a_file_would(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    extra = '[run]\nseed = 3\noutput = "x"\n[joint]\nlimit_rad = 1e-3\n[interval]\nlevel = 0.8\n'
    by_options = config_from_options(
        "compare", ["before.csv", "after.csv"], seed=3, out="x", limit_rad=1e-3, level=0.8
    )
    assert by_options == load(folder, extra)


def test_options_win_over_the_file_they_start_from(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    base = write(folder, COMPARE + FULL)
    config = config_from_options(
        "fit", ["after.csv"], base, level=0.5, curve="published", seed=None
    )
    assert isinstance(config, FitConfig)
    assert [recording.name for recording in config.recordings] == ["after"]
    assert config.interval.level == 0.5
    assert config.interval.kind == "hdi"
    assert config.curve.source == "published"
    assert config.run.seed == 7


def test_other_recordings_have_an_output_folder_of_their_own(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    base = write(folder, COMPARE + FULL)
    own = config_from_options("compare", ["after.csv", "before.csv"], base).run.output
    assert own == folder / "results" / "compare_after_before"
    assert load_config(base).run.output != own


def test_what_a_file_states_of_a_recording_holds_where_that_is_named_again(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    dated = COMPARE.replace('file = "before.csv"', 'file = "before.csv"\ndate = 2026-03-01')
    dated = dated.replace('file = "after.csv"', 'file = "after.csv"\ndate = 2026-07-01')
    base = write(folder, dated)
    days = [date(2026, 3, 1), date(2026, 7, 1)]
    by_file = config_from_options("compare", ["after.csv", "before.csv"], base)
    assert {entry.name: entry.date for entry in by_file.recordings} == {
        "before": days[0],
        "after": days[1],
    }
    later = [date(2026, 8, 1), date(2026, 9, 1)]
    by_option = config_from_options("compare", ["before.csv", "after.csv"], base, later)
    assert [entry.date for entry in by_option.recordings] == later
    other = folder / "other.csv"
    other.touch()
    undated = config_from_options("compare", ["before.csv", "other.csv"], base)
    assert [entry.date for entry in undated.recordings] == [None, None]
    identified = config_from_options(
        "identify", ["before.csv", "after.csv"], base, bench=folder / "bench.toml"
    )
    assert [entry.date for entry in identified.recordings] == days
    # What is held out has a gap of its own.
    first, last = identified.recordings
    held_out = (first, last.model_copy(update={"use": "hold_out"}))
    identified.model_copy(update={"recordings": held_out}).require_sound()


def test_every_option_of_the_command_line_reaches_its_field(folder: Path) -> None:
    values = {
        "curve": folder / "curve.nc",
        "bench": folder / "bench.toml",
        "route": "amplitude",
        "level": 0.5,
        "limit_rad": 0.01,
        "gear_ratio": 2.0,
        "upright": True,
        "seed": 0,
        "workers": 1,
        "out": folder / "out",
        "start_from": folder / "curve.nc",
        "check_sampler": True,
        "before": date(2027, 1, 1),
    }
    of_a_study = {"scheduler": "tcp://host:8786"}
    of_a_plan = {
        "range_rad": (-0.2, 0.3),
        "speed_rpm": 900.0,
        "acceleration_rpm_per_s": 4000.0,
        "duration_s": 12.0,
        "gap_rad": 1e-3,
    }
    of_an_identification = {"effects": "catalogue"}
    of_a_stated_limit = {"limit": "3 arcmin play"}
    of_others = of_a_study | of_a_plan | of_an_identification | of_a_stated_limit
    assert set(values | of_others) == set(OPTIONS)
    files, dates = [folder / "before.csv", folder / "after.csv"], [date(2026, 3, 1)] * 2
    config = config_from_options("compare", files, None, dates, **values)
    assert config.dates == tuple(dates)
    study = config_from_options("study", (), CONFIGS / "search_study.toml", **of_a_study)
    plan = config_from_options("plan", bench=folder / "bench.toml", **of_a_plan)
    assert plan.bench == folder / "bench.toml"
    bench = folder / "bench.toml"
    identification = config_from_options(
        "identify", files, None, (), bench=bench, **of_an_identification
    )
    assert identification.bench == bench
    limited = config_from_options("compare", files, None, dates, **of_a_stated_limit)
    assert str(limited.joint.limit) == of_a_stated_limit["limit"]
    for option, location in OPTIONS.items():
        field = attrgetter(".".join(map(str, location)))
        if option in of_a_stated_limit:
            continue
        if option in of_a_plan:
            assert field(plan) == of_a_plan[option]
        elif option in of_a_study:
            assert field(study) == of_a_study[option]
        elif option in of_an_identification:
            assert field(identification) == of_an_identification[option]
        else:
            assert field(config) == values[option]


DATED = """schema = 1
kind = "compare"
[joint]
limit_rad = 1.2e-3
decide_before = 2027-01-01
[[recordings]]
file = "after.csv"
date = 2026-07-01
[[recordings]]
file = "before.csv"
date = 2026-03-01
"""


def test_dates_give_the_order_and_without_them_the_file_does(folder: Path) -> None:
    assert [r.name for r in load(folder, base=DATED).recordings] == ["before", "after"]
    undated = re.sub("(?m)^(date|decide_before) = .*$", "", DATED)
    config = load(folder, base=undated)
    assert [r.name for r in config.recordings] == ["after", "before"]
    assert config.dates is None


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("(?m)^date = .*$", "", "needs dated recordings"),
        ("date = 2026-03-01", "", "every one needs its date, or none"),
        ("limit_rad = 1.2e-3", "", "needs a limit"),
        ("2027-01-01", "2026-07-01", "not after the last recording"),
        ("2027-01-01", '"next year"', "decide_before"),
    ],
)
def test_a_date_to_decide_before_that_cannot_be_used_is_refused(
    folder: Path, old: str, new: str, told: str
) -> None:
    with pytest.raises(ConfigError, match=told):
        load(folder, base=re.sub(old, new, DATED))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (DATED + "[wear]\nrelative_sd_per_date = -0.1\n", "relative_sd_per_date"),
        (DATED + "[wear]\nin_service_since = 2026-05-01\n", "gone into service after"),
        (
            re.sub("(?m)^(date|decide_before) = .*$", "", DATED)
            + "[wear]\nrelative_sd_per_date = 0.02\n",
            "needs dated recordings",
        ),
    ],
)
def test_what_is_said_of_wear_and_cannot_be_is_refused(folder: Path, text: str, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        load(folder, base=text)


def test_a_joint_may_be_older_than_its_first_recording(folder: Path) -> None:
    since = "[wear]\nin_service_since = 2024-05-01\n"
    assert load(folder, base=DATED + since).wear.in_service_since == date(2024, 5, 1)
    repaired = DATED.replace("date = 2026-07-01", "date = 2026-07-01\nrepaired = true")
    after = since.replace("2024", "2026")
    assert load(folder, base=repaired + after).wear.in_service_since == date(2026, 5, 1)


def test_what_is_wrong_is_told_at_its_own_line(folder: Path) -> None:
    undated = DATED.replace("date = 2026-03-01\n", "")
    unit = '[columns]\ntime_s = "t"\nmotor_speed_rpm = {name = "n", unit = "mph"}\n'
    for text, where in (
        (undated, "line 9, [[recordings]] 2"),
        (DATED.replace("2027", "2025"), "line 5, [joint] decide_before"),
        (DATED + unit, "line 14, [columns] motor_speed_rpm.unit"),
    ):
        with pytest.raises(ConfigError) as caught:
            load(folder, base=text)
        assert caught.value.where == where
    dates = [date(2026, 3, 1), date(2026, 7, 1)]
    with pytest.raises(ConfigError, match=r"^--before: .*not after the last recording"):
        config_from_options(
            "compare",
            [folder / "before.csv", folder / "after.csv"],
            dates=dates,
            limit_rad=1e-3,
            before=date(2025, 1, 1),
        )


def test_dates_on_the_command_line_pair_up_with_the_recordings(folder: Path) -> None:
    files = [folder / "before.csv", folder / "after.csv"]
    with pytest.raises(ConfigError, match="1 for 2 recordings"):
        config_from_options("compare", files, None, [date(2026, 3, 1)])
    with pytest.raises(ConfigError, match="no rate of wear"):
        config_from_options("fit", files[:1], None, limit_rad=1e-3, before=date(2027, 1, 1))


@pytest.mark.parametrize(
    ("options", "where"),
    [
        ({"level": 1.5}, "--level"),
        ({"limit_rad": -1.0}, "--limit-rad"),
        ({"curve": "none.nc"}, "--curve"),
        ({"seed": -1}, "--seed"),
        ({"route": "scenic"}, "--route"),
        ({"route": "direct"}, "--route"),
        ({"bench": "before.csv"}, "--bench"),
        ({"before": date(2027, 1, 1)}, "--before"),
        ({"before": date(2027, 1, 1), "limit_rad": 1e-3}, "--before"),
    ],
)
def test_a_wrong_option_is_named_as_the_option(
    folder: Path, options: dict[str, object], where: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        config_from_options("fit", [folder / "before.csv"], None, **options)
    assert caught.value.where == where
    assert caught.value.expected


def test_a_missing_recording_on_the_command_line_is_named_by_its_place(folder: Path) -> None:
    with pytest.raises(ConfigError, match=r"^recording 2: There is no such file.*none\.csv"):
        config_from_options("compare", [folder / "before.csv", folder / "none.csv"])
    with pytest.raises(ConfigError, match=r"^recordings: .*1 recording.*at least 2"):
        config_from_options("compare", [folder / "before.csv"])


def test_recordings_with_the_same_file_name_are_numbered(folder: Path) -> None:
    (folder / "later").mkdir()
    (folder / "later" / "before.csv").touch()
    config = config_from_options(
        "compare", [folder / "before.csv", folder / "later" / "before.csv"]
    )
    assert isinstance(config, CompareConfig)
    assert [recording.name for recording in config.recordings] == ["before-1", "before-2"]


def test_importing_the_configuration_loads_no_numerical_library() -> None:
    numerical = {"numpy", "scipy", "numba", "xarray"}
    assert not loaded_by("import bayesbl.config.loading") & numerical
