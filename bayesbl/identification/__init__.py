"""Identify the parameters of a joint's bench from recordings, with a data sheet as the prior.

:mod:`identify` finds the parameters, :mod:`next_recording` suggests a recording, and :mod:`groups`
makes the stored results, their words and the reasons for withholding.
"""
