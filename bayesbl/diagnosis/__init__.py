"""Where simulation and measurement disagree, and which effect of the catalogue is missing.

A comparison (:mod:`inverse`, :mod:`free_motion`) turns recordings and a bench into fits; naming
(:mod:`naming`) asks it for one fit after another and decides; :mod:`report` holds what was decided.
"""
