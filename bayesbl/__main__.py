"""``python -m bayesbl`` is the command ``bayesbl``."""

from bayesbl.cli import main

main()
