"""One question asked of every view: what does the bench lack? See :mod:`.linear`."""
