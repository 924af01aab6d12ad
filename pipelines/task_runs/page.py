"""The tables of reports/learning_tasks/README.md."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

from committed import markdown

Rows = Sequence[Mapping[str, Any]]


def tables(result: Mapping[str, Any]) -> dict[str, str]:
    """Name → table."""
    return {
        "paths": paths(result["paths"]),
        "targets": targets(result["targets"]),
        "swing": swing(result["swing"]),
        "pump": pump(result["pump"]),
        "redundancy": redundancy(result["redundancy"]),
    }


def paths(rows: Rows) -> str:
    """One line for each controller; of several policies the median of each figure."""
    errors = "RMSE x / y / z, mm", "max x / y / z, mm"
    head = ("path, speed ramps", "controller", *errors, "residual swing, mm", "tool settles, s")
    lines = []
    for (path, ease_s, name), group in groupby(rows, lambda row: (row["path"], row["ease_s"], row["controller"])):
        of_policies = list(group)
        lines.append(
            (
                f"{path}, " + (f"{ease_s:g} s" if ease_s else "none"),
                name,
                *(
                    " / ".join(number(statistics.median(row[key][k] for row in of_policies), 1) for k in range(3))
                    for key in ("rmse_mm", "max_mm")
                ),
                number(median([row["swing_mm"] for row in of_policies]), 1),
                number(median([row["settling_s"] for row in of_policies])),
            )
        )
    return markdown(head, lines, "llll")


def targets(rows: Rows) -> str:
    head = ("pendulum of the machine", "controller", "tip arrives, s", "tool settles, s", "residual swing, mm", "not settled")
    lines = []
    for row in rows:
        pendulum = "as identified" if row["length"] == 1.0 else f"{100.0 * (row['length'] - 1.0):+.0f} % in length"
        arrival = spread([move["arrival_s"] for move in row["moves"]])
        lines.append((pendulum, row["controller"], arrival, *rest(row["moves"])))
    return markdown(head, lines, "ll")


def swing(rows: Rows) -> str:
    head = ("controller", "tool settles, s", "residual swing, mm", "not settled")
    return markdown(head, [(row["controller"], *rest(row["moves"])) for row in rows], "l")


def pump(rows: Rows) -> str:
    """Each controller beside inverse kinematics, the first row: the ratio is that of the same move."""
    head = (
        "controller",
        "tip arrives, s",
        "time as a share of ik's",
        "faster than ik in",
        "least distance from a joint's limit",
    )
    first = rows[0]["arrival_s"]
    lines = []
    for row in rows:
        pairs = [(own, base) for own, base in zip(row["arrival_s"], first, strict=True) if own is not None and base is not None]
        ratios = [own / base for own, base in pairs]
        lines.append(
            (
                row["controller"],
                spread(row["arrival_s"]),
                spread(ratios) if row is not rows[0] else "1",
                f"{sum(ratio < 1.0 for ratio in ratios)} of {len(first)}" if row is not rows[0] else "–",
                f"{100.0 * row['margin']:.1f} % of its range",
            )
        )
    return markdown(head, lines, "l")


def redundancy(rows: Rows) -> str:
    """Shares in per cent: median; lowest of all circles."""
    head = (
        "controller",
        "mean distance from the nearest limit, %",
        "at the end, %",
        "farther than ik-lookahead in",
        "RMSE of the tip, mm",
    )
    lines = []
    for row in rows:
        mean, end = (f"{100.0 * statistics.median(row[key]):.1f}; {100.0 * min(row[key]):.1f}" for key in ("mean", "end"))
        better = sum(own > base for own, base in zip(row["mean"], rows[0]["mean"], strict=True))
        count = f"{better} of {len(row['mean'])}" if row is not rows[0] else "–"
        lines.append((row["controller"], mean, end, count, spread(row["rmse_mm"])))
    return markdown(head, lines, "l")


def rest(moves: Rows) -> tuple[str, str, str]:
    """Settling time and residual swing (median; worst), and how many did not settle."""
    never = sum(move["settling_s"] is None for move in moves)
    times, swings = ([move[key] for move in moves] for key in ("settling_s", "swing_mm"))
    return spread(times), spread(swings, 1), f"{never} of {len(moves)}"


def spread(values: Sequence[float | None], digits: int = 2) -> str:
    """Median and greatest; what never happened counts as infinite."""
    worst = None if None in values else max(value for value in values if value is not None)
    return f"{number(median(values), digits)}; {number(worst, digits)}"


def median(values: Sequence[float | None]) -> float | None:
    """None where it is infinite."""
    found = statistics.median(math.inf if value is None else value for value in values)
    return found if found < math.inf else None


def number(value: float | None, digits: int = 2) -> str:
    return "–" if value is None else f"{value:.{digits}f}"
