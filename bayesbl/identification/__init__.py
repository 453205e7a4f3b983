"""A joint of one's own: its bench's parameters from recordings, a data sheet as the prior.

:mod:`identify` finds them, :mod:`verdict` says why they are withheld, :mod:`next_recording` what to
record next, :mod:`groups` and :mod:`summary` what is stored and said.
"""
