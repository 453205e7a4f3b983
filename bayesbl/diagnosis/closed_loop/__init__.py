"""The two-mass bench in its closed loop against speed and current: which effect it lacks.

Recordings are compared with their simulation (:mod:`bayesbl.matching.signals`);
:mod:`candidates` holds what could be missing, :mod:`explain` fits one more candidate,
:mod:`naming` searches, :mod:`criteria` judges, :mod:`prediction` simulates what was held out,
:mod:`augment` writes what was named into the bench.
"""
