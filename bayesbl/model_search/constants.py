"""Thresholds and prior probabilities of the search, each with its reason."""

from __future__ import annotations

NAMED_AT = 0.99
"""Posterior probability from which a hypothesis is reported: if the model is right, one name in a
hundred is false."""

EXPECTED_HYPOTHESES = 0.5
"""Prior expected number of true hypotheses in an unexamined joint, spread evenly over the search.
Each of k hypotheses has odds of 0.5 to k, so a longer catalogue raises no false alarm."""

DISCREPANCY_ABSENT = 0.5
"""Prior probability that one kind of discrepancy is absent."""

DISCREPANCY_SPACING = 2.0**0.5
"""Ratio of neighbouring lattice scales of a discrepancy. The relative error of a scale of m columns
is at least 1/√(2m): 0.35 in the logarithm resolves what eight columns can show."""

DISCREPANCY_LARGEST = 1.0e4
"""Largest scale of a discrepancy, in standard deviations of a sample's noise, beyond any real
joint. The prior is flat in the logarithm, so one more decade costs 0.1 in ln(evidence)."""

FAR = 60.0
"""ln odds against a term added to a set, beyond which the extended set is not pursued."""

BEAM = 24
"""Number of sets extended to the next larger size. Each is tried with every other term."""

KEPT_BELOW = 12.0
"""ln odds against the best set, beyond which a set is dropped: 6e-6."""

MOST_KEPT = 300
"""Number of best sets kept: where a hypothesis is named, the others have no weight."""

MOST_WEIGHED = 1000
"""Number of sets of each size that are weighed with sign constraints: the most probable without
them."""

WEIGHED_SHARE = 0.999
"""Share of the probability over which a disagreement, reported with two digits, is averaged."""

CONFOUNDED_MOST = 4
"""Largest number of confounded hypotheses reported together; more say nothing."""

UNEXPLAINED_SHARE = 0.05
"""Unexplained share of the disagreement, without the means, from which nothing is named."""

HOPEFUL_SHARE = 0.1
"""Share of the disagreement that the best of the first sets must explain for the search to go on.
The largest of three independent parts explains a third."""

FORM_SHARE = 0.1
"""Error of a law's form, relative to its own signal. In eleven joints whose shaft follows the
Bouc-Wen law, Dahl's law left up to the square of this in χ²."""

LEAVES_MOST, SLACK = 2.0, 100.0
"""Largest χ² beyond noise that a set to be fitted in full may promise to leave: a multiple of what
the best leaves, plus a constant. Far from the optimum a promise is no better."""

MEAN_SHARE = 0.01
"""Usual error of a channel's mean, relative to its largest line. With offsets of any size, three
means alone would not distinguish friction from them."""

LEARNED_SHARE = 0.01
"""Share of the excess χ² from which a discrepancy is reported: less than a hundredth of what the
names explain is error in the form of their laws."""
