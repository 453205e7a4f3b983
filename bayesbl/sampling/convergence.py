"""Diagnostics of the sampling, as codes and numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from scipy import fft

from bayesbl.errors import NoFlankChange
from bayesbl.recording.types import FloatArray

Outcome = Literal["converged", "usable", "withheld"]

R_HAT_GOOD = 1.01
R_HAT_BAD = 1.05
FEWEST_EFFECTIVE = 400.0
"""Effective draws below which it is reported: the actual level of a 90 % interval is 90 ± 1.5 %.
The share of the posterior between two quantiles of n draws has the standard deviation √(p (1 −
p)/n), with level p. (The same number as 100 in each of four chains, Vehtari et al. 2021.)"""
STEPS_PER_AUTOCORRELATION = 50.0
WINDOW = 5.0
"""Autocorrelation times over which a chain's autocorrelation is summed."""
WEAKEST_SIGNAL_TO_NOISE = 6.0
"""A/σ_A below which the answer is withheld: noise alone hardly ever reaches it. The search takes
the best of many start times, periods and frequencies. In 160 recordings of noise alone it finds 3.8
± 0.9, at most 5.5 (``configs/noise_alone.toml``); none gave an answer."""
AT_BOUND_SHARE, AT_BOUND_TOO_MUCH = 0.05, 0.2
"""Share of draws near a bound that is reported, and share at which the answer is withheld. Within
half a standard deviation of a bound lie 7 % of a normal posterior that is cut off two standard
deviations from its peak, 14 % if cut off at one, 24 % if cut off at the peak."""
STUCK_ACCEPTANCE = 0.05
OTHER_ANSWER_SHARE = 0.05
"""Probability of another optimum, with another amplitude, above which the answer is withheld."""


@dataclass(frozen=True, slots=True)
class Flaw:
    """A fault of draws or of an answer; :mod:`bayesbl.sentences` makes its sentence.

    Attributes
    ----------
    code
        A key of :data:`bayesbl.sentences.SENTENCES`.
    values
        Numbers and names that its sentence needs.
    """

    code: str
    values: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Contender:
    """Another optimum, which the sampler does not reach.

    Attributes
    ----------
    log_odds
        ln of its probability over that of the chosen optimum.
    """

    amplitude_rpm: float
    log_odds: float

    @property
    def share(self) -> float:
        """Its probability if only it and the optimum existed."""
        return 1.0 / (1.0 + math.exp(min(-self.log_odds, 700.0)))


@dataclass(frozen=True, slots=True)
class Diagnostics:
    """How the sampling ended.

    Attributes
    ----------
    r_hat, ess_bulk
        By symbol; chains are the independent ensembles, never the walkers of one.
    autocorrelation_steps
        Longest integrated autocorrelation time over symbols and ensembles, steps.
    steps
        Steps of each ensemble after burn-in.
    acceptance
        Mean accepted share of proposals per ensemble, shape (e,).
    failures, doubts
        Why δ must not be used, and why it is to be used with care.
    code
        Code of the first failure, for programs.
    """

    r_hat: Mapping[str, float]
    ess_bulk: Mapping[str, float]
    autocorrelation_steps: float
    steps: int
    acceptance: FloatArray
    failures: tuple[Flaw, ...] = ()
    doubts: tuple[Flaw, ...] = ()
    code: str = "sampling"

    @property
    def outcome(self) -> Outcome:
        """``withheld`` with failures, ``usable`` with doubts only, else ``converged``."""
        return "withheld" if self.failures else "usable" if self.doubts else "converged"

    @property
    def reasons(self) -> tuple[Flaw, ...]:
        """All failures and doubts, the gravest first."""
        return self.failures + self.doubts


def rank_r_hat_and_ess(
    draws: Mapping[str, FloatArray],
) -> tuple[dict[str, float], dict[str, float]]:
    """Rank-normalised split R̂ and bulk ESS (Vehtari et al. 2021) of draws (chain, draw) by name."""
    from arviz_stats.base import array_stats

    # Draws that are all alike have the R̂ nan, which is reported as a sentence.
    with np.errstate(invalid="ignore"):
        r_hat = {n: float(array_stats.rhat(x, method="rank")) for n, x in draws.items()}
        ess = {n: float(array_stats.ess(x, method="bulk")) for n, x in draws.items()}
    return r_hat, ess


def integrated_time(chain: FloatArray) -> float:
    """Integrated autocorrelation time of one ensemble's chain, (step, walker, d), in steps.

    The largest over the symbols; infinite if a walker does not move. It is 1 + 2 Σ ρ_k, with ρ the
    walkers' mean autocorrelation, up to the first lag k ≥ 5 times the sum so far (Sokal 1997).
    :func:`emcee.autocorr.integrated_time` does the same, but returns 1 if there is no such lag.
    """
    steps = len(chain)
    centred = chain - chain.mean(axis=0)
    if steps < 8 or np.any(centred.std(axis=0) == 0.0):
        return math.inf
    spectrum = np.abs(fft.rfft(centred, fft.next_fast_len(2 * steps, real=True), axis=0)) ** 2
    covariance = fft.irfft(spectrum, axis=0)[:steps]
    sums = 2.0 * np.cumsum((covariance / covariance[0]).mean(axis=1), axis=0) - 1.0
    beyond = np.arange(steps)[:, None] >= WINDOW * sums
    ends = np.where(beyond.any(axis=0), beyond.argmax(axis=0), steps - 1)
    longest = float(sums[ends, np.arange(ends.size)].max())
    return max(1.0, longest) if math.isfinite(longest) else math.inf


def judge(
    ended: Diagnostics,
    bounds_stable: bool,
    signal_to_noise: float = math.inf,
    at_bound: Mapping[str, float] | None = None,
    other_answer: Contender | None = None,
    most_steps: float = math.inf,
) -> Diagnostics:
    """Derive an outcome with its reasons from the numbers.

    Parameters
    ----------
    ended
        How the sampling ended, without failures and doubts.
    bounds_stable
        Whether the interval's bounds agreed between the last two checks.
    signal_to_noise
        A / √V_AA.
    at_bound
        By symbol, the share of draws at a bound of its range.
    other_answer
        The most probable optimum with another amplitude, if there is one.
    most_steps
        No setting allows more.
    """
    doubts: list[Flaw] = []
    failures: list[Flaw] = []
    r_hat, ess_bulk, acceptance = ended.r_hat, ended.ess_bulk, ended.acceptance
    steps, autocorrelation_steps = ended.steps, ended.autocorrelation_steps
    is_weak = signal_to_noise < WEAKEST_SIGNAL_TO_NOISE
    if is_weak:
        values = {"deviations": signal_to_noise, "needed": WEAKEST_SIGNAL_TO_NOISE}
        failures.append(Flaw("ringing_weak", values))
    worst = max(r_hat, key=lambda n: r_hat[n])
    worst_values = {"symbol": worst, "r_hat": r_hat[worst]}
    if not r_hat[worst] < R_HAT_BAD:
        failures.append(Flaw("ensembles_disagree", worst_values | {"needed": R_HAT_BAD}))
    elif r_hat[worst] > R_HAT_GOOD:
        doubts.append(Flaw("ensembles_differ", worst_values | {"good": R_HAT_GOOD}))
    slowest = int(np.argmin(acceptance))
    if (share := float(acceptance[slowest])) < STUCK_ACCEPTANCE:
        values = {"number": slowest + 1, "ensembles": len(acceptance), "share": share}
        failures.append(Flaw("ensemble_stuck", values | {"needed": STUCK_ACCEPTANCE}))
    if not math.isfinite(autocorrelation_steps):
        failures.append(Flaw("walker_stuck"))
    elif not steps > STEPS_PER_AUTOCORRELATION * autocorrelation_steps:
        # A short chain underestimates its autocorrelation time.
        needed_steps = 2 * math.ceil(STEPS_PER_AUTOCORRELATION * autocorrelation_steps)
        values = {
            "steps": steps,
            "autocorrelation_steps": autocorrelation_steps,
            "needed": STEPS_PER_AUTOCORRELATION,
        }
        advised = needed_steps if needed_steps <= most_steps else None
        flaw = Flaw("chain_short", {**values, "needed_steps": advised})
        enough = steps > 0.4 * STEPS_PER_AUTOCORRELATION * autocorrelation_steps
        (doubts if enough else failures).append(flaw)
    fewest = min(ess_bulk, key=lambda n: ess_bulk[n])
    if not ess_bulk[fewest] > FEWEST_EFFECTIVE:
        doubts.append(Flaw("few_effective", {"symbol": fewest, "draws": ess_bulk[fewest]}))
    if not (bounds_stable or is_weak):
        doubts.append(Flaw("bounds_moved"))
    for name, share in (at_bound or {}).items():
        # Draws of a weak ringing may lie anywhere; its weakness is reported already.
        if share > AT_BOUND_SHARE and not is_weak:
            flaw = Flaw("draws_at_bound", {"symbol": name, "share": share})
            (failures if share > AT_BOUND_TOO_MUCH else doubts).append(flaw)
    if other_answer is not None and other_answer.share > OTHER_ANSWER_SHARE:
        values = {"amplitude_rpm": other_answer.amplitude_rpm, "share": other_answer.share}
        failures.append(Flaw("other_optimum", values))
    code = NoFlankChange.code if is_weak else "sampling"
    return replace(ended, failures=tuple(failures), doubts=tuple(doubts), code=code)
