"""Where each equation, table and figure of the paper is: in code, configuration and result.

    python docs/make_paper.py

writes ``docs/paper.md``. Whatever it names is looked up: a function that is not there, a file that
is missing or a variable that no group declares ends it, and ``tests/test_docs.py`` with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from bayesbl.measurement import shared_groups
from bayesbl.measurement.routes import ROUTES
from bayesbl.results.variables import Group

ROOT = Path(__file__).resolve().parents[1]
PAGE = Path(__file__).parent / "paper.md"


@dataclass(frozen=True, slots=True)
class Item:
    """A piece of the paper.

    Attributes
    ----------
    code
        ``module:object`` below ``bayesbl``, or a file of the repository.
    configuration
        Files, with the key that matters behind a space.
    result
        Variables of ``result.nc`` by path, or files.
    """

    name: str
    what: str
    code: tuple[str, ...]
    configuration: tuple[str, ...] = ()
    result: tuple[str, ...] = ()


ITEMS = (
    Item(
        "Eq. 1, 2",
        "two masses with a dead zone",
        ("bench.kernel:simulate", "bench.effects.gap:BACKLASH"),
        ('configs/bench.toml gap_form = "dead_zone"',),
    ),
    Item(
        "K_BL, τ_l",
        "variable stiffness (arctan), the default gap",
        ("bench.kernel:simulate",),
        ('configs/bench.toml gap_form = "arctan"',),
    ),
    Item(
        "Table 1",
        "system parameters",
        ("bench.parameters:BENCH_PARAMETERS",),
        ("configs/bench.toml [parameters]",),
    ),
    Item(
        "Eq. 3",
        "the ringing after one impact",
        ("ringing.waveform:impact",),
        ("configs/wear_snapshots.toml [estimator.model]",),
        ("amplitude/predictive/model_rpm",),
    ),
    Item(
        "Eq. 5, 6",
        "the train of pulses h(t), with a baseline",
        ("ringing.waveform:pulse_train", "ringing.waveform:model_speed"),
        (),
        ("amplitude/optimum/baseline_rpm", "amplitude/predictive/model_rpm"),
    ),
    Item(
        "RMSE",
        "the cost of CMA-ES, in rpm and relative",
        ("ringing.objective:Objective", "ringing.optimum:find_optimum"),
        (),
        ("amplitude/optimum/rmse_rpm", "amplitude/optimum/relative_rmse"),
    ),
    Item(
        "Table 2, x0, σ0",
        "ranges and starts as printed (`box_search` of `summary.json`); by default the search "
        "starts from guesses",
        ("ringing.table_2:search_as_printed",),
        ("configs/search_study.toml",),
        ("amplitude/search_history/rmse_rpm",),
    ),
    Item(
        "seven unknowns",
        "posterior of the seven symbols under the recording's noise",
        ("ringing.posterior:sample_posterior", "noise.rotation_noise:estimate_noise"),
        ("configs/wear_snapshots.toml [posterior]",),
        (
            "amplitude/posterior/amplitude_rpm",
            "amplitude/optimum/covariance",
            "amplitude/noise/coefficients",
            "amplitude/log_likelihood/recording",
        ),
    ),
    Item(
        "Eq. 4",
        "δ(A) as printed, with its rounding; the cubic of a sweep, with its uncertainty",
        (
            "curve.gap_curve:published_curve",
            "curve.sweep:regress",
            "curve.sweep:swept_curve",
        ),
        ("configs/wear_published.toml", "configs/sweep.toml"),
        (
            "amplitude/curve/coefficients",
            "amplitude/curve/covariance",
            "amplitude/curve/coefficient_draws",
        ),
    ),
    Item(
        "A₁, A₂, δ₁, δ₂",
        "draws of A and of the curve give draws of δ and its change",
        ("measurement.gap_by_curve:gaps", "measurement.stored:change_group"),
        ("configs/wear_snapshots.toml",),
        (
            "amplitude/posterior/delta_rad",
            "amplitude/posterior/curve_amplitude_rpm",
            "amplitude/budget/share",
        ),
    ),
    Item("Figure 3", "the disturbance and its symbols", ("paper_figures/figure_3.py",)),
    Item("Figure 5", "the variable stiffness", ("paper_figures/figure_5.py",)),
    Item("Figure 6", "recording and simulation", ("paper_figures/figure_6.py",)),
    Item(
        "Figure 7",
        "the disturbance as the gap grows",
        ("paper_figures/figure_7.py", "presentation.figures.sweep:disturbance"),
        ("configs/sweep.toml",),
    ),
    Item(
        "Figure 8",
        "amplitude and gap, the regression",
        ("paper_figures/figure_8.py", "presentation.figures.sweep:curve"),
        ("configs/sweep.toml",),
    ),
    Item(
        "Figure 9",
        "recordings with the fitted model",
        ("paper_figures/figure_9.py", "presentation.figures.ringing:signal"),
        ("configs/wear_snapshots.toml",),
        ("amplitude/predictive/model_rpm", "amplitude/predictive/residual_rpm"),
    ),
    Item(
        "Figure 10",
        "the two gaps",
        (
            "paper_figures/figure_10.py",
            "presentation.figures.gap:amplitude_to_gap",
            "presentation.figures.gap:gap",
        ),
        ("configs/wear_snapshots.toml",),
        ("amplitude/posterior/delta_rad", "amplitude/curve/coefficient_draws"),
    ),
    Item(
        "Section 5",
        "the paper's CMA-ES on recordings of known truth",
        ("experiments/search.py",),
        ("configs/search_study.toml",),
    ),
)

HEAD = """# The paper, piece by piece

`python docs/make_paper.py` writes this page and checks every name on it.

The paper's method is the amplitude route. `bayesbl run configs/wear_snapshots.toml` stores all of
it under `/amplitude` of `result.nc`. `python paper_figures/make_all.py` draws the paper's figures,
except 1, 2 and 4, which are photographs and diagrams.

| in the paper | what | code | configuration | result |
|---|---|---|---|---|"""


def pages() -> dict[Path, str]:
    """What the file should hold."""
    return {PAGE: "\n".join([HEAD, *map(_row, ITEMS)]) + "\n"}


def _row(item: Item) -> str:
    cells = (
        item.name,
        item.what,
        ", ".join(map(_code, item.code)),
        ", ".join(map(_configuration, item.configuration)),
        ", ".join(map(_result, item.result)),
    )
    return f"| {' | '.join(cells)} |"


def _code(address: str) -> str:
    """Of code that is there.

    Raises
    ------
    AttributeError, FileNotFoundError
        If it is not.
    """
    module, colon, name = address.partition(":")
    if not colon:
        return f"`{_file(address)}`"
    getattr(import_module(f"bayesbl.{module}"), name)
    return f"`bayesbl.{module}.{name}`"


def _configuration(text: str) -> str:
    """A file that is there, and the key that matters in it."""
    file, _, key = text.partition(" ")
    return f"`{_file(file)}`" + (f" (`{key}`)" if key else "")


def _result(path: str) -> str:
    """A variable that a route declares.

    Raises
    ------
    KeyError
        If it does not.
    """
    route, group, variable = path.split("/")
    names = [
        *vars(import_module(ROUTES[route].partition(":")[0])).values(),
        *vars(shared_groups).values(),
    ]
    (declared,) = [one for one in names if isinstance(one, Group) and one.name == group]
    declared.variable(variable)
    return f"`{path}`"


def _file(name: str) -> str:
    if not (ROOT / name).is_file():
        raise FileNotFoundError(name)
    return name


if __name__ == "__main__":
    for file, content in pages().items():
        file.write_text(content, encoding="utf-8")
