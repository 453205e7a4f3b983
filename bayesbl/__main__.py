"""``python -m bayesbl`` is the command ``bayesbl``."""

from bayesbl.cli import main

if __name__ == "__main__":
    main()
