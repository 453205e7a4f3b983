"""What decides, each with where it comes from."""

from __future__ import annotations

NAMED_AT = 0.99
"""Probability from which a hypothesis is reported. One false name in a hundred is the most that a
reader should meet where the model is right."""

EXPECTED_HYPOTHESES = 0.5
"""Hypotheses that hold in a joint nobody has looked at, spread evenly over all of the search. With
k of them each has the odds of 0.5 to k, so that a longer catalogue raises no false alarm."""

DISCREPANCY_ABSENT = 0.5
"""Prior probability that one kind of discrepancy is not there at all."""

DISCREPANCY_SPACING = 2.0**0.5
"""Ratio of neighbouring scales of a discrepancy. A scale of m columns is known to 1/√(2m) of itself
at best: 0.35 in the logarithm resolves what eight columns can show."""

DISCREPANCY_LARGEST = 1.0e4
"""Largest scale of a discrepancy, in standard deviations of a sample's noise. Wider than any real
joint leaves: the prior is flat in the logarithm, so a decade more costs 0.1 in ln(evidence)."""

FAR = 60.0
"""ln of the odds against a term beside a set, beyond which it is not carried on."""

BEAM = 24
"""Sets carried on to the next larger size; each in turn is tried with every other term."""

KEPT_BELOW = 12.0
"""ln of odds against the best set, beyond which a set is dropped: 6e-6."""

MOST_KEPT = 300
"""Sets kept of those, the best: the rest has no weight where one is named."""

MOST_WEIGHED = 1000
"""Sets of each size that are weighed with their signs, the likeliest without."""

WEIGHED_SHARE = 0.999
"""Of the probability, over which a disagreement is averaged: it is told with two digits."""

CONFOUNDED_MOST = 4
"""Hypotheses of a set that is reported because they share one probability; more say nothing."""

UNEXPLAINED_SHARE = 0.05
"""Of the disagreement beside the means: what none holds, from which on nothing is named."""

HOPEFUL_SHARE = 0.1
"""Of the disagreement: what the best of the sets tried first must hold, for a search to go on. The
largest of three independent parts of a whole holds a third of it."""

FORM_SHARE = 0.1
"""Of a law's own signal: what it may be off by for its form. Of eleven joints whose shaft follows
Bouc-Wen's law, Dahl's left up to the square of that in χ²."""

LEAVES_MOST, SLACK = 2.0, 100.0
"""χ² beyond noise that what is fitted in full promises to leave, at most: a multiple of what the
best leaves, and an amount more. Far from its optimum a promise is no better."""

MEAN_SHARE = 0.01
"""Usual error of a channel's mean, over its largest line. Three means alone would not tell friction
from offsets of any size."""

LEARNED_SHARE = 0.01
"""Of the excess chi-square that a discrepancy must hold to be told: less than a hundredth of what
the names explain is the form of their laws."""
