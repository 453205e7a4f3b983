"""What people pass to the public functions: taken as it is, or refused in one sentence."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import bayesbl
from bayesbl.arguments import as_dates
from bayesbl.config.bench import reference_bench
from bayesbl.config.loading import DEEPEST
from bayesbl.errors import UserError
from bayesbl.library import _files

TIME = np.arange(400) / 100.0
SPEED = 2000.0 + np.sin(TIME)
COLUMNS = {"time_s": TIME, "motor_speed_rpm": SPEED}


def in_memory() -> Mapping[str, Any]:
    frame = pd.DataFrame(COLUMNS)
    return {
        "mapping": COLUMNS,
        "lists": {name: column.tolist() for name, column in COLUMNS.items()},
        "frame": frame,
        "frame over time": frame.set_index("time_s"),
        "dataset": xr.Dataset({"motor_speed_rpm": ("time_s", SPEED)}, {"time_s": TIME}),
        "pair": (TIME, SPEED),
        "recording": bayesbl.Recording("r", TIME, {"motor_speed_rpm": SPEED}),
    }


@pytest.mark.parametrize("form", in_memory())
def test_a_recording_in_memory_is_read_as_its_file_would_be(form: str, tmp_path: Path) -> None:
    from bayesbl.arguments import as_recording

    file = tmp_path / "r.csv"
    pd.DataFrame(COLUMNS).to_csv(file, index=False)
    with _files([as_recording(in_memory()[form]), file], None) as (files, _):
        first, second = map(bayesbl.read_recording, files)
    np.testing.assert_array_equal(first.time_s, second.time_s)
    assert [*first.channels] == [*second.channels]
    np.testing.assert_array_equal(first.motor_speed_rpm, second.motor_speed_rpm)
    assert not files[0].exists()


@pytest.mark.long
def test_a_frame_and_a_bench_in_memory_give_what_their_files_give(tmp_path: Path) -> None:
    bench = reference_bench()
    seen = bench.simulate(8e-4, sampling_hz=300.0, seed=np.random.default_rng(1))
    frame = pd.DataFrame({"time_s": seen.time_s, "motor_speed_rpm": seen.motor_speed_rpm})
    frame.to_csv(tmp_path / "r.csv", index=False, float_format="%.17g")
    config = tmp_path / "fit.toml"
    config.write_text('schema = 1\nkind = "fit"\n[posterior]\nensembles = 2\nmax_steps = 300\n')
    by_file, by_frame = (bayesbl.fit(r, config=config) for r in (tmp_path / "r.csv", frame))
    name = "amplitude_rpm"
    np.testing.assert_array_equal(
        *(found.to_xarray()["amplitude/posterior"][name].values for found in (by_file, by_frame))
    )


ODD: Mapping[str, Any] = {
    "nothing": None,
    "a number": 3,
    "bytes": b"a.csv",
    "a table": np.zeros((5, 2)),
    "columns of two lengths": {"time_s": TIME, "motor_speed_rpm": SPEED[1:]},
    "a number for a column": {"time_s": 1.0, "motor_speed_rpm": SPEED},
    "a column of text": {"time_s": TIME, "motor_speed_rpm": ["x"] * TIME.size},
    "columns by number": {0: TIME, 1: SPEED},
    "three arrays": (TIME, SPEED, SPEED),
    "an object": object(),
    "a set": {"a.csv"},
    "a function": print,
}


@pytest.mark.parametrize("odd", ODD)
@pytest.mark.parametrize(
    ("function", "call"),
    [
        ("fit", lambda x: bayesbl.fit(x)),
        ("compare", lambda x: bayesbl.compare("a.csv", x)),
        ("identify", lambda x: bayesbl.identify(x, bench="b.toml")),
        ("diagnose", lambda x: bayesbl.diagnose(x, bench="b.toml")),
    ],
)
def test_what_is_no_recording_is_refused_in_words(
    function: str, call: Callable[[Any], Any], odd: str
) -> None:
    with pytest.raises(UserError) as refusal:
        call(ODD[odd])
    told = str(refusal.value)
    assert f"{function}()" in told
    assert "pandas.DataFrame" in told
    assert "\n" not in told


@pytest.mark.parametrize("odd", [3, 1.5, b"x", ["a"], {"a": 1}, object(), np.zeros(3)])
@pytest.mark.parametrize(
    "call",
    [
        lambda x: bayesbl.fit("a.csv", config=x),
        lambda x: bayesbl.fit("a.csv", bench=x),
        lambda x: bayesbl.fit("a.csv", curve=x),
        lambda x: bayesbl.fit("a.csv", start_from=x),
        lambda x: bayesbl.compare("a.csv", "b.csv", dates=x),
        lambda x: bayesbl.identify("a.csv", effects=[x]),
        lambda x: bayesbl.sweep(x),
        lambda x: bayesbl.run(x),
        lambda x: bayesbl.read_result(x),
        lambda x: bayesbl.write_page(x),
        lambda x: bayesbl.load_bench(x),
        lambda x: bayesbl.load_config(x),
        lambda x: bayesbl.read_recording(x),
        lambda x: bayesbl.summarise(x),
    ],
)
def test_every_public_function_refuses_in_words(call: Callable[[Any], Any], odd: Any) -> None:
    with pytest.raises(UserError, match="Expected: "):
        call(odd)


def test_dates_may_be_text() -> None:
    days = [date(2026, 3, 1), "2026-03-02", pd.Timestamp(2026, 3, 3)]
    assert as_dates(days) == [date(2026, 3, n) for n in (1, 2, 3)]


def test_one_recording_has_one_gap() -> None:
    with pytest.raises(UserError, match="one value of each setting"):
        reference_bench().simulate(np.array([8e-4, 9e-4]))


@pytest.mark.parametrize("key", ["a" + ".a" * 3000 + " = 1", "a = " + "[" * 500 + "]" * 500])
def test_a_file_nested_without_end_is_refused(key: str, tmp_path: Path) -> None:
    file = tmp_path / "deep.toml"
    file.write_text(f'schema = 1\nkind = "fit"\n{key}\n')
    with pytest.raises(UserError, match=r"nested too deeply.*more than") as refusal:
        bayesbl.load_config(file)
    assert str(DEEPEST) in str(refusal.value)
