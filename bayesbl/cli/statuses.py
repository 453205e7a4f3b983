"""Exit statuses besides 0."""

FAILED, WRONG, WITHHELD, INTERRUPTED = 1, 2, 3, 130
"""What no user can mend; usage, config or input; no answer; Ctrl-C."""
