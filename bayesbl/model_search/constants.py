"""Thresholds and prior probabilities of the search, each with its reason."""

from __future__ import annotations

NAMED_AT = 0.99
"""Posterior probability from which a hypothesis is reported. If the model is right, one reported
name in a hundred is false."""

EXPECTED_HYPOTHESES = 0.5
"""Prior expected number of true hypotheses in a joint that nobody has examined, spread evenly over
all hypotheses of the search. Each of k hypotheses has prior odds of about 0.5/k, so a longer
catalogue raises no false alarm."""

DISCREPANCY_ABSENT = 0.5
"""Prior probability that one kind of discrepancy is absent."""

DISCREPANCY_SPACING = 2.0**0.5
"""Ratio of neighbouring lattice scales of a discrepancy. The relative standard error of a scale
estimated from m columns is at least 1/√(2m): a spacing of 0.35 in the logarithm resolves what eight
columns can show."""

DISCREPANCY_LARGEST = 1.0e4
"""Largest scale of a discrepancy, in standard deviations of a sample's noise. No real joint reaches
it. The prior is flat in the logarithm, so one more decade costs 0.1 in ln(evidence)."""

FAR = 60.0
"""ln odds against a term added to a set, beyond which the extended set is not pursued."""

BEAM = 24
"""Number of sets extended to the next larger size. Each is tried with every other term."""

KEPT_BELOW = 12.0
"""ln odds against the best set, beyond which a set is dropped: 6e-6."""

MOST_KEPT = 300
"""Number of sets kept, the best ones. Where a hypothesis is named, the others have no weight."""

MOST_WEIGHED = 1000
"""Number of sets of each size whose evidence is computed with the sign constraints: the most
probable ones without these constraints."""

WEIGHED_SHARE = 0.999
"""Share of the probability over which a disagreement is averaged. It is reported with two digits.
"""

CONFOUNDED_MOST = 4
"""Largest number of confounded hypotheses that are reported together. A larger group says nothing.
"""

UNEXPLAINED_SHARE = 0.05
"""Share of the disagreement, means left out, that may remain unexplained. Beyond it, nothing is
named."""

HOPEFUL_SHARE = 0.1
"""Share of the disagreement that the best of the first sets must explain for the search to go on.
The largest of three independent parts explains a third of the whole."""

FORM_SHARE = 0.1
"""Error of a law's form, as a share of its own signal. In eleven joints whose shaft follows the
Bouc-Wen law, Dahl's law left up to the square of this share in χ²."""

LEAVES_MOST, SLACK = 2.0, 100.0
"""Limits on the χ² beyond noise that a set may promise to leave if it is to be fitted in full: a
multiple of what the best set leaves, plus a constant. Far from the optimum, a linear promise is no
more exact."""

MEAN_SHARE = 0.01
"""Usual error of a channel's mean, as a share of the channel's largest line. With offsets of any
size, three means alone would not distinguish friction from offsets."""

LEARNED_SHARE = 0.01
"""Smallest share of the excess χ² for which a discrepancy is reported. Less than a hundredth of
what the names explain is error in the form of their laws."""
