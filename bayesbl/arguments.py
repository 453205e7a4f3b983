"""Check and convert what people pass to the public functions.

The annotation of a parameter says what it accepts. :func:`checked` refuses everything else in a
sentence with function, parameter, value and expectation.
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date, datetime
from functools import cache, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ParamSpec, TypeVar, get_args

from bayesbl.errors import UserError, shortened

if TYPE_CHECKING:
    from numpy.typing import NDArray

P = ParamSpec("P")
R = TypeVar("R")
Arrays = dict[str, "NDArray[Any]"]  # columns by name, of a recording in memory


@dataclass(frozen=True, slots=True)
class Takes:
    """Annotation of a parameter: what it accepts, in words, and its conversion.

    ``convert`` raises TypeError or ValueError, whose text is shown if it has one.
    """

    expected: str
    convert: Callable[[Any], Any]


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """The function with its arguments converted as annotated; UserError for an invalid one."""
    signature = inspect.signature(function)

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        bound = signature.bind(*args, **kwargs)
        for name, takes in _takes(function).items():
            if name not in bound.arguments:
                continue
            value, parameter = bound.arguments[name], signature.parameters[name]
            if parameter.kind is parameter.VAR_POSITIONAL:
                value = tuple(_converted(function, name, takes, item) for item in value)
            elif value is not parameter.default:
                value = _converted(function, name, takes, value)
            bound.arguments[name] = value
        return function(*bound.args, **bound.kwargs)

    return call


@cache
def _takes(function: Callable[..., Any]) -> dict[str, Takes]:
    takes = {}
    for name, parameter in inspect.signature(function).parameters.items():
        annotation = parameter.annotation
        if isinstance(annotation, str):
            try:
                annotation = eval(annotation, function.__globals__)
            except NameError:
                continue  # imported for the type checker alone: not converted
        for part in (annotation, *get_args(annotation)):
            for item in get_args(part):
                if isinstance(item, Takes):
                    takes[name] = item
    return takes


def _converted(function: Callable[..., Any], name: str, takes: Takes, value: Any) -> Any:
    try:
        return takes.convert(value)
    except (TypeError, ValueError, RecursionError) as error:
        raise UserError(
            f"{function.__name__}() cannot use this." + (f" {error}" if str(error) else ""),
            where=name,
            found=described(value),
            expected=takes.expected,
        ) from None


def described(value: Any) -> str:
    """What a value is, in a few words."""
    kind = f"{type(value).__module__.partition('.')[0]}.{type(value).__qualname__}"
    kind = kind.removeprefix("builtins.")
    if value is None or isinstance(value, bool | int | float | str | bytes):
        return shortened(repr(value)) if value is None else f"{shortened(repr(value))} ({kind})"
    shape = getattr(value, "shape", None)
    if isinstance(shape, tuple):
        return f"{kind} of shape {shape}"
    return f"{kind} of {len(value)}" if hasattr(value, "__len__") else kind


def as_path(value: Any) -> Path:
    """A path."""
    if isinstance(value, bytes) or not isinstance(value, str | os.PathLike):
        raise TypeError
    return Path(value)


def as_dates(value: Any) -> list[date]:
    """Dates, also as ISO text."""
    if isinstance(value, str | date) or not isinstance(value, Iterable):
        raise TypeError
    return [_date(item) for item in value]


def _date(value: Any) -> date:
    if isinstance(value, str):
        return date.fromisoformat(value)
    if isinstance(value, datetime):
        return value.date()
    if not isinstance(value, date):
        raise TypeError
    return value


def as_names(value: Any) -> str | list[str]:
    """A word that stands for all, or names."""
    if isinstance(value, str):
        return value
    if not isinstance(value, Iterable) or isinstance(value, bytes | Mapping):
        raise TypeError
    names = list(value)
    if not all(isinstance(name, str) for name in names):
        raise TypeError
    return names


def as_recording(value: Any) -> Path | Arrays:
    """A path, or the columns of a recording in memory."""
    import numpy as np

    if isinstance(value, str | os.PathLike):
        return as_path(value)
    columns = {name: np.asarray(column) for name, column in _columns(value).items()}
    for name, column in columns.items():
        if not isinstance(name, str) or not name or "/" in name:
            raise TypeError(f"A column is named {shortened(repr(name))}.")
        if column.ndim != 1 or column.dtype.kind not in "biufM":
            raise TypeError(
                f'Column "{shortened(name)}" is {column.ndim}-dimensional of '
                f"{column.dtype}, not a row of numbers."
            )
    if len({column.size for column in columns.values()}) != 1:
        raise TypeError("Its columns differ in length.")
    return columns


def _columns(value: Any) -> Mapping[Any, Any]:
    if isinstance(value, Mapping) and not hasattr(value, "data_vars"):
        return value
    if hasattr(value, "data_vars"):  # an xarray Dataset
        return {name: item.values for name, item in value.variables.items() if item.ndim == 1}
    if hasattr(value, "channels") and hasattr(value, "time_s"):  # a Recording
        return {"time_s": value.time_s, **value.channels}
    if hasattr(value, "columns") and hasattr(value, "__getitem__"):  # pandas, polars
        index: Any = getattr(value, "index", None)
        name = getattr(index, "name", None)
        named = {} if name is None else {name: index}
        return {**named, **{column: value[column] for column in value.columns}}
    if isinstance(value, tuple | list) and len(value) == 2:
        return dict(zip(("time_s", "motor_speed_rpm"), value, strict=True))
    raise TypeError


def as_formats(value: Any) -> tuple[str, ...]:
    """Formats of figures."""
    formats = (value,) if isinstance(value, str) else tuple(as_names(value))
    if not set(formats) <= {"png", "pdf"}:
        raise ValueError
    return formats


def as_tree(value: Any) -> Any:
    """The tree of a result, or of a result object."""
    import xarray as xr

    tree = value if isinstance(value, xr.DataTree) else getattr(value, "to_xarray", lambda: None)()
    if not (isinstance(tree, xr.DataTree) and isinstance(tree.attrs.get("kind"), str)):
        raise TypeError
    return tree


File = Annotated[str | Path, Takes("a path: str or pathlib.Path", as_path)]
RecordingLike = Annotated[
    Any,
    Takes(
        "a path (str or pathlib.Path), a pandas.DataFrame, an xarray.Dataset, a Recording, a "
        "mapping of names to arrays, or a pair of arrays (time in s, motor speed in rpm)",
        as_recording,
    ),
]
Dates = Annotated[
    Sequence[date], Takes('a list of dates, each a datetime.date or "2026-03-01"', as_dates)
]
Names = Annotated[str | Sequence[str], Takes('"catalogue", or a list of names', as_names)]
Formats = Annotated[Sequence[str], Takes('"png", "pdf", both or none', as_formats)]
Tree = Annotated[Any, Takes("the tree of a result (xarray.DataTree), or a Result", as_tree)]
