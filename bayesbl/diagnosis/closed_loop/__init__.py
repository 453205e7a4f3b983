"""The two-mass bench in its closed loop against speed and current: which effect it lacks.

Recordings are compared with their simulation (:mod:`bayesbl.matching.signals`), and
:mod:`bayesbl.model_search` finds what is missing. Here :mod:`diagnosis` makes the answer,
:mod:`learned_in_loop` learns what no name explains, :mod:`prediction` writes what was found into
the bench, simulates what was held out, and says what to record next.
"""
