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
#: A stage within this multiple of its noise floor is explained.
EXPLAINED = 1.1
#: Factor by which an effect has to reduce the variance: it moves the output by ``STANDARD_ERRORS`` times what remains.
PRICE = 1.0 + STANDARD_ERRORS**2
#: Number of likeliest survivors that a minimal one is compared with, the discrepancy of each estimated beside it alone.
LIKELIEST = 3
#: 97.5 % quantile of the normal distribution.
Z = 1.959964
