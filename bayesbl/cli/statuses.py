"""Exit statuses besides 0."""

FAILED, WRONG, WITHHELD = 1, 2, 3
"""What no user can mend, or Ctrl-C; usage, config or input; no answer."""
