"""What a process loads that has loaded nothing yet."""

from __future__ import annotations

import subprocess
import sys


def loaded_by(statement: str) -> set[str]:
    """Top-level modules that are loaded after a statement in a new process."""
    code = f"{statement}\nimport sys; print('', *sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return {name.partition(".")[0] for name in done.stdout.splitlines()[-1].split()}
