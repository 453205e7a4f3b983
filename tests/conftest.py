"""How tests run: linear algebra on one thread, a whole run on every core, figures on demand.

The threads are set before NumPy is imported; processes that tests start inherit them. On busy
cores, threads waiting for one another cost tenfold.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
from mosquitto import Broker, mosquitto_is_installed
from places import EXPERIMENTS
from quick import without_figures

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

LONGEST = (
    "test_paper_figures.py",
    "test_golden.py",
    "test_two_encoders.py",
    "test_always_in.py",
    "test_forms.py",
    "test_cli.py",
    "test_figures.py",
    "test_forward.py",
    "test_joint_change.py",
    "test_calibration.py",
    "test_direct.py",
    "test_wear_detection.py",
    "test_sweep.py",
    "test_direct_results.py",
    "test_page.py",
)
"""Files that a whole run starts with, or it would end with one core waiting for another.

In a fresh clone the first compiles the simulator while the second compiles the ringing model.
"""


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config: pytest.Config) -> None:
    """A run of all tests leaves out the long ones, which ``--all`` takes in, and uses every core;
    naming files takes in all of theirs and, as ``-n 0`` does, keeps it in one process."""
    options = config.option
    whole = config.args_source is pytest.Config.ArgsSource.TESTPATHS
    if whole and not options.all and not options.markexpr:
        options.markexpr = "not long"
    is_worker = hasattr(config, "workerinput")
    if not whole or is_worker or not config.pluginmanager.hasplugin("xdist"):
        return
    if options.numprocesses is None and not options.usepdb:
        options.numprocesses = "logical"
        options.dist = "loadfile"  # what a file's tests share is made once
        # Its first import on a day writes a file, and fails where two processes do so at once.
        importlib.import_module("arviz")
        options.loadscopereorder = False


def pytest_addoption(parser: pytest.Parser) -> None:
    """``--all``: the long tests too, where no file is named."""
    parser.addoption("--all", action="store_true", help="the tests marked long as well")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest files first."""
    rank = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: rank.get(item.path.name, len(rank)))


@pytest.fixture
def no_figures() -> Iterator[None]:
    """Runs of this test write no figures."""
    with without_figures():
        yield


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    """A running broker, empty at first."""
    pytest.importorskip("paho.mqtt")
    if not mosquitto_is_installed():
        pytest.skip("needs mosquitto: apt-get install mosquitto")
    made = Broker(tmp_path / "broker")
    made.start()
    yield made
    made.stop()


@pytest.fixture(scope="session")
def independent() -> Iterator[ModuleType]:
    """The simulator that shares only equations with the package's own."""
    path = EXPERIMENTS / "independent_bench.py"
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules[path.stem]
