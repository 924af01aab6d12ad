"""The numbers of the decision rule; each follows from a level of significance (``docs/decisions/decision-rule.md``)."""

from __future__ import annotations

#: Two-sided 5 % of a normal sum of block differences (Vehtari, Gelman, Gabry, Stat. Comput. 27, 2017).
STANDARD_ERRORS = 2.0
#: Odds of e³ ≈ 20 to 1, "strong" evidence (Kass and Raftery, JASA 90, 1995); 95 % with equal priors [nats].
LEAST = 3.0
#: "Very strong" evidence in one block (same scale) [nats].
BLOCK_NATS = 5.0
#: Least share of the closable gap on held-out recordings: less has no practical significance.
SHARE = 0.01
#: Ratio of two RMS errors without practical significance, of an error and its noise floor for instance.
TENTH = 1.1
#: Factor by which an effect has to reduce the variance: it moves the output by ``STANDARD_ERRORS`` times what remains.
PRICE = 1.0 + STANDARD_ERRORS**2
#: Factor by which one effect has to reduce the variance beside the others: it moves the output by what remains unexplained, of
#: which a smaller one may be part.
BESIDE = 2.0
#: Number of likeliest survivors that a minimal one is compared with, the discrepancy of each estimated beside it alone.
LIKELIEST = 3
#: 97.5 % quantile of the normal distribution.
Z = 1.959964


def at_floor(left: float) -> bool:
    """Whether an error is at the noise floor; ``left`` in noise floors."""
    return left <= TENTH


def as_little(left: float, other: float) -> bool:
    """Whether no more than a tenth more is left than by another, or than the noise floor; both in noise floors."""
    return left <= TENTH * max(other, 1.0)
