"""Search for what the bench lacks, as a posterior over sets of hypotheses. See :mod:`.linear`."""
