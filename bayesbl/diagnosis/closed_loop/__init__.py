"""The two-mass bench in its closed loop against speed and current: which effect is missing.

Recordings stand beside their simulation (:mod:`bayesbl.matching.signals`); :mod:`candidates`
holds what could be missing, :mod:`explain` fits one more candidate, :mod:`naming` searches,
:mod:`criteria` judges, :mod:`evaluate` tells the gap before and after, :mod:`augment` writes what
was named into the bench.
"""
