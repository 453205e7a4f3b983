"""A result holds the configuration that made it, which may be run again into the same folder."""

from __future__ import annotations

from pathlib import Path

import pytest
from places import BEFORE

from bayesbl.runs.kinds import check


@pytest.mark.parametrize(("name", "refused"), [("config.toml", False), ("mine.toml", True)])
def test_only_the_configuration_that_is_written_back_may_lie_in_its_output(
    tmp_path: Path, name: str, refused: bool
) -> None:
    (tmp_path / "result.nc").touch()  # a finished result
    config = tmp_path / name
    config.write_text(
        'schema = 1\nkind = "fit"\n[run]\noutput = "."\n'
        f'[[recordings]]\nname = "before"\nfile = "{BEFORE}"\n'
    )
    problems = [problem.problem for problem in check(config).problems]
    assert ("An output would replace or delete an input." in problems) is refused
