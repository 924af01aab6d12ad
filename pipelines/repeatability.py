"""Repeatability of named effects over several recordings of one machine, the spread of their values, and both as a table."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sysid.cli.output import Printer
from sysid.gap.result import GapResult
from sysid.machine import Machine
from sysid.reports.result_figures import parameters_of

#: Largest spread of consistent values, relative to their median.
TOLERANCE = 0.25
#: An effect is repeatable if at least this share of the runs that excite it name it.
MIN_SHARE = 0.75


@dataclass(frozen=True)
class RepeatedEffect:
    """One effect over several runs of the workflow on the same machine.

    Args:
        shown: runs whose recordings excite the effect and in which it is identifiable (in no non-identifiable set).
        named: those of them in which it was named.
        parameters: parameter → its value in each run of ``named``, in that order.
    """

    name: str
    target: str
    shown: tuple[str, ...]
    named: tuple[str, ...]
    parameters: Mapping[str, tuple[float, ...]]

    def median(self, parameter: str) -> float:
        return statistics.median(self.parameters[parameter])

    def spread(self, parameter: str) -> float:
        """(largest − smallest) / 2, relative to the median; zero for a single value."""
        values, middle = self.parameters[parameter], self.median(parameter)
        half = 0.5 * (max(values) - min(values))
        return half / abs(middle) if middle else (float("inf") if half else 0.0)

    @property
    def verdict(self) -> str:
        """``consistent``; ``moves``: named repeatedly, with inconsistent values; ``sometimes``: not named in other runs."""
        if len(self.named) < max(2, MIN_SHARE * len(self.shown)):
            return "sometimes"
        return "consistent" if all(self.spread(key) <= TOLERANCE for key in self.parameters) else "moves"

    def to_json(self) -> dict[str, object]:
        spreads = {key: {"median": self.median(key), "spread": self.spread(key)} for key in self.parameters}
        parts = {"shown": list(self.shown), "named": list(self.named), "parameters": dict(self.parameters)}
        return {"name": self.name, "target": self.target, "verdict": self.verdict, **parts, "over_runs": spreads}


def repeatability(results: Mapping[str, GapResult]) -> tuple[RepeatedEffect, ...]:
    """Every effect that any of the runs named, in the order in which they first appear.

    Args:
        results: run → result; all of the same machine, each from other recordings.
    """
    keys = dict.fromkeys((e.name, e.target) for result in results.values() for e in result.effects)
    return tuple(_repeat(name, target, results) for name, target in keys)


def _repeat(name: str, target: str, results: Mapping[str, GapResult]) -> RepeatedEffect:
    shown, named = [], []
    values: dict[str, list[float]] = {}
    for run, result in results.items():
        if any((name, target) in tie for tie in result.ambiguous):  # not identifiable: the run does not count
            continue
        effect = next((e for e in result.effects if (e.name, e.target) == (name, target)), None)
        excited = any(x.sufficient for x in result.excitation if (x.name, x.target) == (name, target))
        if effect is not None or excited:
            shown.append(run)
        if effect is not None:
            named.append(run)
            for key, value in effect.given.items():
                for place, number in enumerate(value if isinstance(value, tuple | list) else (value,)):
                    label = f"{key}[{place}]" if isinstance(value, tuple | list) else key
                    values.setdefault(label, []).append(float(number))
    return RepeatedEffect(name, target, tuple(shown), tuple(named), {key: tuple(numbers) for key, numbers in values.items()})


def show_repeatability(out: Printer, repeats: Sequence[RepeatedEffect], machine: Machine) -> None:
    """Share of the runs in which each effect was named, and the spread of its values."""
    if not repeats:
        out.line("no effect was named in any run")
        return
    words = {
        "consistent": "consistent",
        "moves": "NOT consistent: value varies",
        "sometimes": "NOT consistent: not named in all runs",
    }
    rows = []
    for item in repeats:
        first = (item.name, item.target, f"{len(item.named)} of {len(item.shown)}")
        for number, (key, values) in enumerate(item.parameters.items()):
            low, middle, high = (
                parameters_of(item.name, item.target, {key: value}, machine)[0].text
                for value in (min(values), item.median(key), max(values))
            )
            tail = (key, middle, f"{low} … {high}", f"{100.0 * item.spread(key):.0f} %")
            rows.append((*(first if number == 0 else ("", "", "")), *tail, words[item.verdict] if number == 0 else ""))
    out.table(("effect", "target", "named in", "parameter", "median", "range", "±", "over the runs"), rows, right=(2, 4, 5, 6))
