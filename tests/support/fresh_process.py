"""What a process loads that has loaded nothing yet."""

from __future__ import annotations

import subprocess
import sys


def loaded_by(statement: str) -> set[str]:
    """Modules that are loaded after a statement in a new process, and their top-level ones."""
    code = f"{statement}\nimport sys; print('', *sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    names = done.stdout.splitlines()[-1].split()
    return {*names, *(name.partition(".")[0] for name in names)}
