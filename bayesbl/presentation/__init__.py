"""What users read and see of a result: sentences, terminal, page, figures."""
