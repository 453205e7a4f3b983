"""A joint of one's own: its bench's parameters from recordings, a data sheet as the prior.

:mod:`identify` finds them, :mod:`next_recording` says what to record next, :mod:`groups` what is
stored and said, and why something is withheld.
"""
