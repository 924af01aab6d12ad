"""Rates over many evaluated cases, with Wilson intervals, and the confusion matrix."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from hidden.evaluate import COARSE, DESCRIBED, CaseResult

#: Quantile of the normal distribution for 95 %.
Z = 1.959964
#: So much of the closable gap is to close.
CLOSED = 0.95


def wilson(hits: int, cases: int) -> list[float]:
    """95 % interval of a rate (Wilson, J. Amer. Statist. Assoc. 22 (1927) 209)."""
    if cases == 0:
        return [0.0, 1.0]
    share = hits / cases
    middle = (share + Z * Z / (2 * cases)) / (1.0 + Z * Z / cases)
    half = Z * math.sqrt(share * (1.0 - share) / cases + Z * Z / (4.0 * cases * cases)) / (1.0 + Z * Z / cases)
    return [max(middle - half, 0.0), min(middle + half, 1.0)]


def rate(hits: Iterable[bool]) -> dict[str, Any]:
    """``value`` is None where there was no case."""
    seen = list(hits)
    value = sum(seen) / len(seen) if seen else None
    return {"value": value, "wilson95": wilson(sum(seen), len(seen)), "hits": sum(seen), "cases": len(seen)}


def scored(cases: Sequence[CaseResult]) -> dict[str, Any]:
    """The figures of the result file; a case without an answer counts as a failure and as not exact."""

    def of(*groups: str) -> list[CaseResult]:
        return [case for case in cases if case.spec.group in groups]

    answered = [case for case in cases if case.failure is None]
    due = [case for case in of("single") if case.due]
    fine = [e for case in cases for key, e in case.errors.items() if not any(_is(key, *each) for each in COARSE)]
    coarse = {
        f"{effect}.{parameter}": _spread([e for case in cases for key, e in case.errors.items() if _is(key, effect, parameter)])
        for effect, parameter in COARSE
    }
    closed = [case.closed for case in cases if case.closed is not None]
    seconds = [case.seconds for case in cases if math.isfinite(case.seconds)]
    return {
        "rates": {
            "false_naming_none": rate(bool(case.named) for case in of("none") if case.failure is None),
            "single_right": rate(case.exact for case in due),
            "single_described_right": rate(case.exact for case in due if case.explained >= DESCRIBED),
            "single_abstained": rate(not case.named for case in due),
            "single_wrong": rate(bool(case.wrong) for case in due),
            "single_below_limit_wrong": rate(bool(case.wrong) for case in of("single") if not case.due),
            "wrong_name": rate(bool(case.wrong) for case in answered),
            "double_exact": rate(case.exact for case in of("double")),
            "triple_exact": rate(case.exact for case in of("triple")),
            "unknown_not_misnamed": rate(not case.named and case.failure is None for case in of("unknown")),
            "unknown_described": rate(case.unnamed for case in of("unknown")),
            "interval_coverage": rate(hit for case in cases for hit in case.covered.values()),
            "interval_coverage_alike": rate(case.covered[key] for case in cases for key in case.alike),
            "interval_coverage_unlike": rate(
                hit for case in cases for key, hit in case.covered.items() if key not in case.alike
            ),
            "closed": rate(case.closed >= CLOSED for case in cases if case.exact and case.closed is not None),
            "failure": rate(case.failure is not None for case in cases),
        },
        "parameter_error": {**_spread(fine), "coarse": coarse},
        "closed_min": min(closed, default=None),
        "closed_median": float(np.median(closed)) if closed else None,
        "seconds": {"median": float(np.median(seconds)) if seconds else None, "max": max(seconds, default=None)},
        "confusion": confusion(cases),
        "refusals": refusals(cases),
    }


def refusals(cases: Sequence[CaseResult]) -> dict[str, dict[str, int]]:
    """Condition for a name → how often an effect fails it, counted apart for effects that are hidden and for others."""
    table: dict[str, dict[str, int]] = {}
    for case in cases:
        for name, target, lacks in case.refused:
            counts = table.setdefault(lacks, {"hidden": 0, "other": 0})
            counts["hidden" if (name, target) in case.hidden else "other"] += 1
    return dict(sorted(table.items()))


def confusion(cases: Sequence[CaseResult]) -> dict[str, dict[str, int]]:
    """Hidden effect → counts of named effects, for cases with one or no hidden effect; rows ``nothing`` and ``unknown`` too."""
    table: dict[str, Counter[str]] = {}
    for case in cases:
        if case.spec.group in ("double", "triple"):
            continue
        row = case.hidden[0][0] if case.hidden else "nothing" if case.spec.group == "none" else "unknown"
        called = [
            name if (name, target) not in case.wrong or row != name else f"{name}, elsewhere" for name, target in case.named
        ]
        nothing = "no answer" if case.failure is not None else case.verdict
        table.setdefault(row, Counter()).update(called or [nothing])
    return {row: dict(sorted(counts.items())) for row, counts in sorted(table.items())}


def _is(key: str, effect: str, parameter: str) -> bool:
    return key.startswith(f"{effect}(") and key.endswith(f".{parameter}")


def _spread(values: Sequence[float]) -> dict[str, Any]:
    if not values:
        return {"median": None, "p90": None, "count": 0}
    return {"median": float(np.median(values)), "p90": float(np.quantile(values, 0.9)), "count": len(values)}
