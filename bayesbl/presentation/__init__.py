"""What the user reads on the terminal: every sentence in :mod:`bayesbl.presentation.words`."""
