"""A file of one section: from TOML to its model, everything that is wrong told at once."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from bayesbl.config.fields import BASE_DIRECTORY, Section
from bayesbl.config.problems import config_error, problems_of
from bayesbl.errors import ConfigError

_Model = TypeVar("_Model", bound=Section)


def load_file(path: Path, model: type[_Model]) -> _Model:
    """The file, validated; its paths start from its own folder.

    Raises
    ------
    ConfigError
        Naming file and field: no such file, no TOML, or what the model refuses.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
        tables = tomllib.loads(text)
    except (OSError, ValueError, RecursionError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ConfigError(
            "The file cannot be read as TOML.",
            file=path,
            found=reason,
            expected="key = value; text stands in quotes",
        ) from None
    try:
        return model.model_validate(tables, context={BASE_DIRECTORY: path.absolute().parent})
    except ValidationError as error:
        raise config_error(problems_of(error, model, text), path) from None
