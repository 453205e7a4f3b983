"""All figures here from stored results; says which command makes a result that is missing."""

from __future__ import annotations

import sys
from importlib import import_module

from common import main

NUMBERS = (3, 5, 6, 7, 8, 9, 10)

FIGURES = [(f"figure_{number}", import_module(f"figure_{number}").draw) for number in NUMBERS]

if __name__ == "__main__":
    sys.exit(main(FIGURES))
