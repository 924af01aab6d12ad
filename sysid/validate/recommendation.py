"""Whether a network or a simple model is the better choice, from their errors on the same held-out rows."""

from __future__ import annotations

import math
from collections.abc import Mapping

from sysid.names import listed

#: Errors that differ by less are alike; the promotion policy permits the same.
ALIKE = 1.05


def recommendation(errors: Mapping[str, tuple[float, Mapping[str, float]]]) -> str:
    """One sentence on what to use; empty without a simple model that predicts every output.

    Args:
        errors: output → RMSE of the network, and RMSE of each simple model, in one unit for each output.
    """
    names = [set(simple) for _, simple in errors.values()]
    common = sorted(set.intersection(*names)) if names else []
    if not common:
        return ""
    ratios = {name: {output: _ratio(own, simple[name]) for output, (own, simple) in errors.items()} for name in common}
    best = max(common, key=lambda name: sum(map(math.log, ratios[name].values())))
    worse = [output for output, ratio in ratios[best].items() if ratio > ALIKE]
    better = [output for output, ratio in ratios[best].items() if ratio < 1.0 / ALIKE]
    if worse and not better:
        factors = _factors([ratios[best][output] for output in worse])
        where = "every output" if len(worse) == len(errors) else listed(worse)
        return f"Use the {best}: its error is {factors} times smaller on {where}."
    if better and not worse:
        factors = _factors([1.0 / ratios[best][output] for output in better])
        where = "every output" if len(better) == len(errors) else listed(better)
        return f"Use the network: its error is {factors} times smaller than that of the best simple model ({best}) on {where}."
    if not worse:
        return f"The {best} is as accurate and simpler."
    return f"The network is more accurate than the {best} on {listed(better)}, and less on {listed(worse)}."


def _ratio(own: float, simple: float) -> float:
    """Bounded, so that an exact model can be compared."""
    return min(max(own / simple if simple > 0.0 else math.inf, 1e-6), 1e6) if own > 0.0 or simple > 0.0 else 1.0


def _factors(values: list[float]) -> str:
    low, high = (f"{value:.1f}" if value < 9.95 else f"{value:.0f}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"
