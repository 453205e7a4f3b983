"""Bench, simulate and sweep files with anything in them: one message, never a traceback."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from places import CONFIGS

from bayesbl import cli
from bayesbl.config.bench import load_bench
from bayesbl.config.kinds import SimulateFile
from bayesbl.config.loading import dump_config, load_config, load_file
from bayesbl.config.sections import RunConfig
from bayesbl.errors import UserError

BENCH = (CONFIGS / "bench.toml").read_text()
SWEEP = 'schema = 1\nkind = "sweep"\nbench = "bench.toml"\n[sweep]\n'
SIMULATE = 'schema = 1\nkind = "simulate"\nbench = "bench.toml"\n[[recordings]]\n'
ENTRY = 'name = "a"\nfile = "a.csv"\nreference_speed_rpm = 2000\n'
DIAGNOSE = (
    'schema = 1\nkind = "diagnose"\nbench = "bench.toml"\n[[recordings]]\nfile = "bench.toml"\n'
    'use = "split"\n[candidates]\n'
)
FIT = 'schema = 1\nkind = "fit"\n[[recordings]]\nfile = "bench.toml"\n'

# The text, where it is wrong, and what the message must say.
REFUSED = {
    "nothing": ("", "kind", "kind of run is missing"),
    "no kind": ("schema = 1\n", "kind", '"compare"'),
    "a misspelt kind": ('schema = 1\nkind = "fitt"\n', "line 2", 'Did you mean "fit"'),
    "a kind that is a number": ("schema = 1\nkind = 3\n", "line 2", "Found: 3"),
    "a list for a file": ('schema = 1\nkind = ["fit"]\n', "kind", "no such kind"),
    "no quotes": ("schema = 1\nkind = fit\n", "line 2", "not valid TOML"),
    "an open bracket": ("schema = 1\n[run\n", "line 2", "not valid TOML"),
    "a decimal comma": (FIT + "[interval]\nlevel = 0,9\n", "line 6", "not valid TOML"),
    "another schema": (FIT.replace("1", "2"), "line 1", "Found: 2"),
    "a folder for a recording": (
        FIT.replace("bench.toml", ".") + 'name = "a"\n',
        "[[recordings]] 1",
        "a folder",
    ),
    "a recording that is not there": (
        FIT.replace("bench.toml", "no.csv"),
        "line 4, [[recordings]] 1 file",
        "no such file",
    ),
    "a recording that is none": (FIT, "bench.toml", "cannot be read as recordings"),
    "a name with a slash": (FIT + 'name = "a/b"\n', "line 5", "cannot be a name"),
    "a date that is text": (FIT + 'date = "March"\n', "line 5", "a date"),
    "time mapped in kilometres": (
        FIT + '[columns]\ntime_s = {name = "t", unit = "km"}\n',
        "[columns]",
        "datenum",
    ),
    "a sweep of no gaps": (SWEEP + "gap_rad = {low = 1e-3, high = 1e-4}\n", "line 5", "low < high"),
    "a sweep of text": (SWEEP + 'gap_rad = "all"\n', "line 5", "a table"),
    "half a rotation": (SWEEP + "rotations = 0.5\n", "line 5", "equal to 2"),
    "a sweep without a bench": (SWEEP.replace("bench.toml", "no.toml"), "line 3", "no such file"),
    "a simulation of nothing": (SIMULATE.replace("[[recordings]]\n", ""), "recordings", "missing"),
    "a gap below zero": (SIMULATE + ENTRY + "gap_rad = -1\n", "gap_rad", "equal to 0"),
    "an infinite gap": (SIMULATE + ENTRY + "gap_rad = inf\n", "gap_rad", "finite"),
    "an effect that is none": (
        DIAGNOSE + 'effects = ["load_coulomb"]\n',
        "line 8, [candidates] effects: There is no such effect.",
        "Did you mean \"load_coulomb_friction\"? Found: 'load_coulomb'. Expected: one of ",
    ),
    "an effect without brackets": (
        DIAGNOSE + 'effects = "load_coulomb_friction"\n',
        "line 8, [candidates] effects: This is not a list",
        "Found: 'load_coulomb_friction'. Expected: \"all\"",
    ),
    "no effect": (DIAGNOSE + "effects = []\n", "line 8, [candidates] effects", "Found: []"),
    "two recordings in one file": (
        SIMULATE + ENTRY + "gap_rad = 1e-3\n[[recordings]]\n" + ENTRY + "gap_rad = 1e-3\n",
        "recordings",
        "same",
    ),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "bench.toml").write_text(BENCH)
    return tmp_path


@pytest.mark.parametrize("case", REFUSED)
def test_a_wrong_configuration_ends_in_one_message_and_status_2(
    folder: Path, case: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text, where, words = REFUSED[case]
    path = folder / "config.toml"
    path.write_text(text)
    assert cli.status(["run", str(path)]) == 2
    printed = capsys.readouterr()
    assert printed.err.startswith(f"Error: {folder}")
    assert len(printed.err.splitlines()) == 1
    assert where in printed.err
    assert words in printed.err
    assert "Expected: " in printed.err
    assert sorted(item.name for item in folder.iterdir()) == ["bench.toml", "config.toml"]


LEAVES = st.one_of(
    st.integers(),
    st.floats(),
    st.booleans(),
    st.text(max_size=5),
    st.sampled_from(["bench.toml", "a.csv", "ar", "white", "two_mass", "load_coulomb_friction"]),
    st.sampled_from(["fit", "compare", "study", "~nobody", "a" * 300]),
    st.dates(),
)
KEYS = st.sampled_from(
    [
        *("schema", "seed", "estimator", "model", "fixed", "ranges", "level", "curve", "source"),
        *("columns", "motor_speed_rpm", "window_end_s", "interval", "posterior", "study", "rows"),
        *("parameters", "measurement", "effects", "recordings", "sweep", "bench", "name", "file"),
        *("value", "tolerance", "relative_tolerance", "gear_ratio", "speed_noise", "kind"),
        *("gap_rad", "low", "high", "count", "sd_rpm", "coefficients", "encoder_counts", "run"),
        *("motor_inertia_kg_m2", "torque_nm", "drive", "gap_form", "rotations", "estimator"),
    ]
)
VALUES = st.recursive(
    LEAVES,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=3),
    max_leaves=8,
)


def load_simulation(path: Path) -> SimulateFile:
    return load_file(path, SimulateFile)


LOADERS: dict[str, Callable[[Path], object]] = {
    "bench": load_bench,
    "simulate": load_simulation,
    **dict.fromkeys(("sweep", "fit", "compare", "study"), load_config),
}


@settings(max_examples=300, deadline=None, suppress_health_check=list(HealthCheck))
@given(kind=st.sampled_from(sorted(LOADERS)), tables=st.dictionaries(KEYS, VALUES, max_size=5))
def test_no_value_in_a_file_of_any_kind_ends_in_a_traceback(
    folder: Path, kind: str, tables: dict[str, object]
) -> None:
    try:
        text = tomli_w.dumps({"schema": 1, **tables, "kind": kind})
    except (TypeError, ValueError):
        return
    path = folder / "fuzz.toml"
    path.write_text(text, encoding="utf-8", errors="replace")
    with suppress(UserError):
        loaded = LOADERS[kind](path)
        if isinstance(loaded, RunConfig):
            path.write_text(dump_config(loaded))
            assert load_config(path) == loaded


@settings(max_examples=200, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    position=st.integers(0, len(BENCH)),
    replacement=st.one_of(
        st.text(max_size=8),
        st.sampled_from(["-", "0", "1e999", "nan", "[", '"', "\n", "9" * 30, "{value = 1}"]),
    ),
    removed=st.integers(0, 12),
)
def test_no_edit_of_a_bench_file_ends_in_a_traceback(
    folder: Path, position: int, replacement: str, removed: int
) -> None:
    path = folder / "edited.toml"
    text = BENCH[:position] + replacement + BENCH[position + removed :]
    path.write_text(text, encoding="utf-8", errors="replace")
    with suppress(UserError):
        load_bench(path)


@pytest.mark.parametrize("load", [load_bench, load_simulation, load_config])
@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"x = " + b"[" * 5000, b"\x00", b"=\n" * 9])
def test_no_bytes_end_in_a_traceback(
    folder: Path, load: Callable[[Path], object], content: bytes
) -> None:
    path = folder / "bytes.toml"
    path.write_bytes(content)
    with pytest.raises(UserError):
        load(path)
