"""``kind = "study"``: an experiment from a file of its own, and the rows it is run with."""

from __future__ import annotations

import os
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, ValidationInfo, field_validator

from bayesbl.config.fields import InputPath, as_tuple, refuse, require_different, resolve
from bayesbl.config.sections import ClusterRun, RunConfig


def _resolve_row(row: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
    """Text that names a file beside the configuration becomes its full path."""
    return {
        key: str(resolve(value, info))
        if key != "name" and isinstance(value, str) and _names_file(value, info)
        else value
        for key, value in row.items()
    }


def _names_file(text: str, info: ValidationInfo) -> bool:
    return os.path.isfile(resolve(text, info))


class StudyConfig(RunConfig):
    """``kind = "study"``: an experiment from a file of its own, row by row.

    A row is a free table that the study itself validates; only its ``name`` is required here.
    """

    kind: Literal["study"]
    run: ClusterRun
    study: InputPath
    rows: Annotated[
        tuple[Annotated[dict[str, Any], AfterValidator(_resolve_row)], ...],
        BeforeValidator(as_tuple),
    ]

    @field_validator("rows")
    @classmethod
    def _named(cls, rows: tuple[dict[str, Any], ...]) -> tuple[dict[str, Any], ...]:
        names = [row.get("name") for row in rows]
        if not rows:
            refuse("A study needs rows.", expected="at least one [[rows]]")
        if not all(isinstance(name, str) and name.strip() for name in names):
            refuse("A row has no name.", found=names, expected="a name as text in every row")
        require_different(list(map(str, names)), "Two rows have the same name.")
        return rows
