"""Exit statuses besides 0."""

FAILED, WRONG, WITHHELD = 1, 2, 3
"""A bug or Ctrl-C; wrong usage, configuration or input; an answer that is withheld."""
