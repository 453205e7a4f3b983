"""What the user reads and sees of a result: sentences, terminal, page, figures."""
