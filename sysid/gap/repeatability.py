"""Does the same machine get the same names from each of its recordings? What repeats, and how far the values spread."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from dataclasses import dataclass

from sysid.gap.result import GapResult

#: Values that lie within this share of their median agree.
TOLERANCE = 0.25
#: A name that comes from at least this share of the runs that could show it repeats.
MOST = 0.75


@dataclass(frozen=True)
class Repeat:
    """One effect over several runs of the workflow on the same machine.

    Args:
        shown: runs whose recordings contain what the effect needs and tell it from others (it is in no tie there).
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
        """(largest − smallest) / 2, as a share of the median; zero of a single value."""
        values, middle = self.parameters[parameter], self.median(parameter)
        half = 0.5 * (max(values) - min(values))
        return half / abs(middle) if middle else (float("inf") if half else 0.0)

    @property
    def verdict(self) -> str:
        """``consistent``; ``moves``: named again and again, with values that disagree; ``sometimes``: not named elsewhere."""
        if len(self.named) < max(2, MOST * len(self.shown)):
            return "sometimes"
        return "consistent" if all(self.spread(key) <= TOLERANCE for key in self.parameters) else "moves"

    def to_json(self) -> dict[str, object]:
        spreads = {key: {"median": self.median(key), "spread": self.spread(key)} for key in self.parameters}
        parts = {"shown": list(self.shown), "named": list(self.named), "parameters": dict(self.parameters)}
        return {"name": self.name, "target": self.target, "verdict": self.verdict, **parts, "over_runs": spreads}


def stability(results: Mapping[str, GapResult]) -> tuple[Repeat, ...]:
    """Every effect that any of the runs named, in the order in which they first appear.

    Args:
        results: run → its answer; all about the same machine, each from other recordings.
    """
    keys = dict.fromkeys((e.name, e.target) for result in results.values() for e in result.effects)
    return tuple(_repeat(name, target, results) for name, target in keys)


def _repeat(name: str, target: str, results: Mapping[str, GapResult]) -> Repeat:
    shown, named = [], []
    values: dict[str, list[float]] = {}
    for run, result in results.items():
        if any((name, target) in tie for tie in result.ambiguous):  # a recording that cannot tell says neither yes nor no
            continue
        effect = next((e for e in result.effects if (e.name, e.target) == (name, target)), None)
        excited = any(x.sufficient for x in result.excitation if (x.name, x.target) == (name, target))
        if effect is not None or excited:
            shown.append(run)
        if effect is not None:
            named.append(run)
            for key, value in effect.parameters.items():
                for place, number in enumerate(value if isinstance(value, tuple | list) else (value,)):
                    label = f"{key}[{place}]" if isinstance(value, tuple | list) else key
                    values.setdefault(label, []).append(float(number))
    return Repeat(name, target, tuple(shown), tuple(named), {key: tuple(numbers) for key, numbers in values.items()})
