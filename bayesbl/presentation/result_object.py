"""Results as objects: they print their answer, show it in a notebook, plot, and give their numbers.

An object holds the result's tree alone; all that it says and draws comes from there.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from bayesbl.errors import ResultError
from bayesbl.presentation.console import SUBJECTS, blocks
from bayesbl.recording.channels import did_you_mean
from bayesbl.runs.kinds import summarise

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

    from bayesbl.presentation.figures.stored_figure import StoredFigure
    from bayesbl.runs.kinds import Summary

Row = Mapping[str, Any]


class Plots:
    """The figures of a result, each a method: ``result.plot.gap()``; ``result.plot()`` is one.

    Where a figure is drawn for each snapshot or recording, ``of`` says which, else for the first.
    """

    def __init__(self, tree: xr.DataTree) -> None:
        self._tree = tree

    def __call__(self, name: str | None = None, of: str | None = None) -> Figure:
        """One figure by name.

        Raises
        ------
        ResultError
            If the result has no such figure, or it is not drawn for such a part.
        """
        known = self._known()
        if name is None:
            name = next(iter(known), "")
        if name not in known:
            raise ResultError(
                "This result has no such figure." + did_you_mean(name, known),
                found=name,
                expected=", ".join(known) or "a result that has figures",
            )
        parts = {ending.strip("_"): drawn for ending, drawn in known[name].parts(self._tree)}
        part = next(iter(parts)) if of is None else of.replace(" ", "_")
        if part not in parts:
            raise ResultError(
                f"The figure {name} is not drawn for such a part.",
                found=of,
                expected=", ".join(filter(None, parts)) or "nothing: it shows the whole result",
            )
        return known[name](*parts[part])

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name not in self._known():
            raise AttributeError(f"there is no figure {name!r}: {', '.join(self._known())}")
        plot = partial(self, name)
        plot.__doc__ = self._known()[name].caption
        return plot

    def __dir__(self) -> Iterable[str]:
        return self._known()

    def _known(self) -> dict[str, StoredFigure]:
        from bayesbl.presentation.figures.stored_figure import figures_of

        return {figure.name: figure for figure in figures_of(self._tree)}


class Result:
    """A result of any kind.

    ``print(result)`` gives the answer as the command does, a notebook shows it as a page would,
    and ``result["gap"]`` is a group of the tree.
    """

    def __init__(self, tree: xr.DataTree) -> None:
        self._tree = tree

    @cached_property
    def summary(self) -> Summary:
        """What ``summary.json`` holds."""
        return summarise(self._tree)

    @property
    def plot(self) -> Plots:
        """The figures."""
        return Plots(self._tree)

    def to_xarray(self) -> xr.DataTree:
        """Everything, in groups that ArviZ knows, units on every variable."""
        return self._tree

    def to_dataframe(self) -> pd.DataFrame:
        """The answer as a table: estimates with ``_low`` and ``_high`` beside them."""
        import pandas as pd

        return pd.DataFrame([_flat(row) for row in self._rows(self.summary)])

    def report(self, path: str | Path = "report.html") -> Path:
        """Write the page: answer, advice, figures and origin in one HTML file.

        Raises
        ------
        ResultError
            If it cannot be written.
        """
        from bayesbl.presentation.page.build import write_page_of

        return write_page_of(self._tree, Path(path))

    @property
    def attrs(self) -> dict[Any, Any]:
        """Kind, outcome and origin, as the tree has them."""
        return self._tree.attrs

    def __getitem__(self, path: str) -> xr.DataTree | xr.DataArray:
        """A group or a variable of the tree: ``result["gap"]``, ``result["gap/delta_rad"]``."""
        return self._tree[path]

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self._headline}>"

    def __str__(self) -> str:
        from bayesbl.presentation.console import print_result
        from bayesbl.presentation.terminal import make_console

        text = io.StringIO()
        print_result(self.summary, None, make_console(file=text))
        return text.getvalue().rstrip()

    def _repr_html_(self) -> str:
        from bayesbl.presentation.page.build import fragment

        return fragment(self._headline, list(blocks(self.summary)))

    @property
    def _headline(self) -> str:
        headline: str = SUBJECTS[self.summary["kind"]].headline(self.summary)
        return headline

    _rows: ClassVar[Any] = staticmethod(lambda summary: [summary])
    """From the summary to the rows of the table."""


class RouteResult:
    """What one route of a fit or a comparison stores, whole: its groups are attributes.

    ``route.posterior["amplitude_rpm"]``, ``route.optimum``, ``route.noise``, ``route.curve``, each
    an xarray dataset with units on every variable.
    """

    def __init__(self, tree: xr.DataTree) -> None:
        self._tree = tree

    def to_datatree(self) -> xr.DataTree:
        """All groups, those that ArviZ knows by its names."""
        return self._tree

    def to_arviz(self, *, noise_only: bool = False) -> Any:
        """As the installed ArviZ takes it: a data tree from its version 1 on.

        Parameters
        ----------
        noise_only
            The posterior is that of the model and its noise alone, which log likelihood, log prior
            and predictions belong to, as for ``arviz.loo``. The answer's is wider: it allows for
            what the model lacks.
        """
        import arviz
        import xarray

        groups: Any = {n: node.to_dataset() for n, node in self._tree.children.items()}
        for name, data in groups.items():  # what only another snapshot has is NaN here
            groups[name] = data.drop_vars([n for n in data if data[n].isnull().all()])
        noise_posterior = groups.pop("noise_posterior", None)
        if noise_only and noise_posterior is not None:
            groups = {**groups, "posterior": noise_posterior}
            del groups["sample_stats"]
        else:
            groups = {n: data for n, data in groups.items() if not n.startswith("log_")}
        if not hasattr(arviz, "InferenceData"):
            return xarray.DataTree.from_dict(groups)
        known = set(arviz.data.inference_data.SUPPORTED_GROUPS_ALL)
        return arviz.InferenceData(**{n: data for n, data in groups.items() if n in known})

    def snapshot(self, name: str) -> RouteResult:
        """The same of one recording of a comparison, without the padding of shorter ones."""
        import xarray

        from bayesbl.measurement.stored import of_snapshot

        recorded = self._tree["observed_data"].to_dataset()
        known = recorded["snapshot"].values.tolist() if "snapshot" in recorded.dims else [name]
        if name not in known:
            raise ResultError("There is no such snapshot.", found=name, expected=", ".join(known))
        groups = {group: of_snapshot(node, name) for group, node in self._tree.children.items()}
        return RouteResult(xarray.DataTree.from_dict(groups))

    def __getattr__(self, name: str) -> xr.Dataset:
        if name.startswith("_") or name not in self._tree.children:
            raise AttributeError(f"there is no group {name!r}: {', '.join(self._tree.children)}")
        return self._tree.children[name].to_dataset()

    def __dir__(self) -> Iterable[str]:
        return [*super().__dir__(), *self._tree.children]

    def __repr__(self) -> str:
        return f"<RouteResult: {', '.join(self._tree.children)}>"


class MeasuredResult(Result):
    """Gaps in recordings; its routes are attributes: ``result.amplitude``, ``result.direct``.

    A group's name gives it of the first route that has it, the one that answers before others:
    ``result.curve``, ``result.noise``.
    """

    to_datatree = Result.to_xarray

    def __getattr__(self, name: str) -> Any:
        from bayesbl.measurement.stored import routes_of

        routes = [] if name.startswith("_") else routes_of(self._tree)
        if name in routes:
            return RouteResult(self._tree.children[name])
        for route in routes:
            if name in self._tree.children[route].children:
                return self._tree.children[route].children[name].to_dataset()
        raise AttributeError(f"there is no {name!r}; routes: {', '.join(routes)}")

    def __dir__(self) -> Iterable[str]:
        from bayesbl.measurement.stored import routes_of

        return [*super().__dir__(), *routes_of(self._tree)]


class FitResult(MeasuredResult):
    """The gap in one recording."""


class ComparisonResult(MeasuredResult):
    """The gap in each recording of one joint, and its change: a row a snapshot."""

    _rows = staticmethod(lambda summary: summary["snapshots"])


class DiagnosisResult(Result):
    """What a bench lacks: a row a parameter of a named effect, or one that is not as believed."""

    @staticmethod
    def _rows(summary: Any) -> Iterator[Row]:
        for effect in summary["effects"]:
            for name, value in effect["parameters"].items():
                yield {"effect": effect["name"], "parameter": name, "value": value}
        for wrong in summary["parameter_errors"]:
            yield {"effect": "", "parameter": wrong["name"], "value": wrong["fitted"]}


class IdentificationResult(Result):
    """A joint's own bench: a row a parameter, then a row a gap."""

    @staticmethod
    def _rows(summary: Any) -> Iterator[Row]:
        for name, parameter in summary["parameters"].items():
            yield {"parameter": name, "unit": parameter["unit"], "value": parameter["posterior"]}
        for name, gap in summary["gaps"].items():
            yield {"parameter": f"delta_rad {name}".strip(), "unit": "rad", "value": gap}


class SweepResult(Result):
    """The gap curve of a bench."""

    def to_dataframe(self) -> pd.DataFrame:
        """What was simulated: a row a gap and start angle."""
        rows: pd.DataFrame = self._tree["sweep"].to_dataset().to_dataframe()
        return rows


_CLASSES: Mapping[str, type[Result]] = {
    "fit": FitResult,
    "compare": ComparisonResult,
    "diagnose": DiagnosisResult,
    "identify": IdentificationResult,
    "sweep": SweepResult,
}


def result_of(tree: xr.DataTree) -> Result:
    """The tree of a result as an object of its kind."""
    return _CLASSES.get(str(tree.attrs.get("kind")), Result)(tree)


def _flat(row: Row) -> dict[str, object]:
    """Plain values as they are, intervals as three columns; what has parts of its own is left."""
    flat: dict[str, object] = {}
    for key, value in row.items():
        if isinstance(value, Mapping) and "median" in value:
            flat[key] = value["median"]
            flat |= {f"{key}_{end}": value[end] for end in ("low", "high")}
        elif not isinstance(value, Mapping | Sequence) or isinstance(value, str):
            flat[key] = value
    return flat
