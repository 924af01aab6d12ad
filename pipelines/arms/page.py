"""The figures as Markdown: each row beside its goal, every case, and the measured machines before and after."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from committed import markdown

Case = Mapping[str, Any]
#: Wall times up to which each is listed.
LISTED = 12
OUTCOMES = ("right", "incomplete", "none", "wrong", "refused", "failure")


def page_tables(result: Mapping[str, Any], before: Mapping[str, Any] | None = None) -> str:
    """Goals and cases of a result.

    Args:
        result: each of its rows states the seeds, commit and date of its own run.
        before: result of an earlier version on development seeds, whose summary stands in a column of its own.
    """
    earlier = _by_section(goal_rows(before["cases"])) if before else {}
    rows = [
        (text, goal, *((earlier.get(key, "–"),) if before else ()), measured, count)
        for key, (text, goal, measured, count) in zip(
            _by_section(goal_rows(result["cases"])), goal_rows(result["cases"]), strict=True
        )
    ]
    header = ("", "goal", *((f"before (seeds {_seeds(before['rows'].values())})",) if before else ()), "measured", "cases")
    parts = [
        markdown(
            ("row", "seeds", "cases", "commit", "date", "command"), [_run(result, row) for row in result["rows"]], "llllll"
        ),
        markdown(header, rows, "ll" + "l" * (len(header) - 2)),
        "All cases that are not right:",
        markdown(
            ("case", "outcome", "wrong", "missed", "simpler form", "reason"),
            [_line(c) for c in result["cases"] if c["outcome"] != "right"],
            "llllll",
        ),
    ]
    return "\n\n".join(parts)


def _by_section(rows: Sequence[tuple[str, str, str, str]]) -> dict[tuple[str, str], str]:
    """(row in bold above, text) → measured; several rows of the table measure the force error."""
    found, section = dict[tuple[str, str], str](), ""
    for text, _, measured, _ in rows:
        section = text if text.startswith("**") else section
        found[section, text] = measured
    return found


def goal_rows(cases: Sequence[Case]) -> list[tuple[str, str, str, str]]:
    """Text, goal, measured, number of cases."""

    def of(row: str, variant: str | None = None) -> list[Case]:
        return [c for c in cases if c["row"] == row and (variant is None or c["variant"] == variant)]

    arms, poses, friction = of("arm"), of("poses", ""), of("smooth_friction")
    plain, masses, eleven = of("servo_sag", "plain"), of("servo_sag", "urdf"), of("poses", "eleven")
    force, velocity, servos = of("flexible", "force"), of("flexible", "velocity"), of("servo_arm")
    loaded = [c for c in arms if c["spread"] is not None]
    mass = [_error(c, "payload") for c in loaded]
    rows = [
        ("**six-axis arm**: right names on every joint", "all", _outcomes(arms), arms),
        ("— an arm with a wrong name", "0", _share(arms, lambda c: bool(c["wrong"])), arms),
        ("— joints' friction, error: median, 90 %, largest", "≤ 5 %", _quantiles(_errors(arms, "friction")), arms),
        ("— payload's mass, error: median, largest", "≤ 5 %", _quantiles(mass, (50, 100)), loaded),
        (
            "— what masses known to 5 % leave of it (1 sd): median, largest",
            "",
            _quantiles([c["spread"] for c in loaded], (50, 100)),
            loaded,
        ),
        ("— force error over the truth's: median, largest", "≤ 1.2", _ratios(arms), arms),
        ("**arm of position servos**, from its MJCF: names right", "≥ 90 %", _outcomes(servos), servos),
        ("— parameter error: median, 90 %, largest", "", _quantiles(_errors(servos, "")), servos),
        ("— held-out error over the encoders' noise: median, largest", "≤ 1.2", _ratios(servos), servos),
        ("— wall time: median, largest [s]", "", _seconds(servos), servos),
        ("**sagging servo, no masses**: nothing wrong", "all", _outcomes(plain), plain),
        ("— a tie of bias and compliance on every sagging joint", "all", _share(plain, lambda c: bool(c["tie"])), plain),
        ("— a next recording is planned", "all", _share(plain, lambda c: c["planned"]), plain),
        ("**sagging servo with masses**: compliance named", "all", _outcomes(masses), masses),
        ("— compliance, error: median, 90 %, largest", "≤ 5 %", _quantiles(_errors(masses, "joint_compliance")), masses),
        ("**500 poses**, geometry and compliance: right names", "all", _outcomes(poses), poses),
        ("— held-out tip error over the truth's: median, largest", "≤ 1.3", _ratios(poses), poses),
        ("— parameter error: median, 90 %, largest", "", _quantiles(_errors(poses, "")), poses),
        ("**11 joints × 400 poses**: wall time [s]", "≤ 60", _seconds(eleven), eleven),
        ("— right names", "all", _outcomes(eleven), eleven),
        ("**flexible drive, force axis**: named, or its resonance described", "all", _outcomes(force), force),
        ("— resonance without a name, error ≤ 10 %", "", _share(force, _described), force),
        (
            "— frequency and inertia ratio, error: median, 90 %, largest",
            "≤ 5–10 %",
            _quantiles(_errors(force, "flexible_drive")),
            force,
        ),
        ("**flexible drive, velocity axis**: named, or its resonance described", "all", _outcomes(velocity), velocity),
        ("— frequency, error: median, 90 %, largest", "≤ 5–10 %", _quantiles(_errors(velocity, "frequency")), velocity),
        ("**smooth friction**: right form", "named or none", _outcomes(friction), friction),
        *((f"— {kind}", "", _outcomes(of("smooth_friction", kind)), of("smooth_friction", kind)) for kind in _kinds(friction)),
        ("— force error over the truth's: median, largest", "", _ratios(friction), friction),
        ("any row: a wrong name", "0", _share(cases, lambda c: bool(c["wrong"])), cases),
        ("any row: no answer (a crash)", "0", _share(cases, lambda c: c["outcome"] == "failure"), cases),
    ]
    return [(text, goal, measured, str(len(there))) for text, goal, measured, there in rows]


def measured_table(rows: Sequence[tuple[str, str, str, str]]) -> str:
    """Errors on measured machines before and after."""
    counts = Counter(change for *_, change in rows)
    summary = ", ".join(f"{count} {change}" for change, count in counts.items())
    return f"{len(rows)} figures: {summary}.\n\n" + markdown(("error", "before", "after", ""), rows, "lrrl")


def _line(case: Case) -> tuple[str, ...]:
    return (
        case["case"],
        case["outcome"] if not _described(case) else f"{case['outcome']}, resonance within {100 * case['resonance']:.1f} %",
        _names(case["wrong"]),
        _names(case["missed"]),
        _names(case["coarse"]),
        case["reason"][:160].replace("|", "\\|"),
    )


def _described(case: Case) -> bool:
    return case["resonance"] is not None and case["resonance"] <= 0.1 and not case["wrong"]


def _outcomes(cases: Sequence[Case]) -> str:
    counts = Counter(case["outcome"] for case in cases)
    return ", ".join(f"{counts[name]} {name}" for name in OUTCOMES if counts[name]) or "–"


def _share(cases: Sequence[Case], test: Callable[[Case], bool]) -> str:
    return f"{sum(map(test, cases))} of {len(cases)}" if cases else "–"


def _errors(cases: Sequence[Case], part: str) -> list[float]:
    """Relative errors of all parameters whose key contains ``part``."""
    return [value for case in cases for key, value in case["errors"].items() if part in key]


def _error(case: Case, part: str) -> float | None:
    return next((value for key, value in case["errors"].items() if part in key), None)


def _quantiles(values: Sequence[float | None], at: Sequence[int] = (50, 90, 100)) -> str:
    known = [value for value in values if value is not None]
    return ", ".join(f"{100.0 * np.percentile(known, q):.1f} %" for q in at) if known else "–"


def _ratios(cases: Sequence[Case]) -> str:
    known = [case["ratio"] for case in cases if case["ratio"] is not None and math.isfinite(case["ratio"])]
    return f"{np.median(known):.2f}, {max(known):.2f}" if known else "–"


def _seconds(cases: Sequence[Case]) -> str:
    """Wall time of each case; of many, median and largest."""
    known = [
        case["wall_seconds"]
        for case in cases
        if case["wall_seconds"] is not None and case["outcome"] not in ("refused", "failure")
    ]
    shown = [float(np.median(known)), max(known)] if len(known) > LISTED else known
    return ", ".join(f"{value:.0f}" for value in shown) or "–"


def _kinds(cases: Sequence[Case]) -> list[str]:
    return list(dict.fromkeys(case["variant"] for case in sorted(cases, key=lambda case: str(case["variant"]))))


def _names(names: Sequence[Sequence[str]]) -> str:
    return ", ".join(f"{name}({target})" for name, target in names) or "–"


def _run(result: Mapping[str, Any], row: str) -> tuple[str, ...]:
    """The run of a row: seeds, number of cases, commits, date, command."""
    own, count = result["rows"][row], sum(case["row"] == row for case in result["cases"])
    commits = ", ".join(f"`{commit[:7]}`" for commit in own["commits"]) or "–"
    return f"`{row}`", _seeds([own]), str(count), commits, own["date"], f"`{own['command']}`"


def _seeds(runs: Iterable[Mapping[str, Any]]) -> str:
    """First and last seed of runs of rows."""
    seeds = [seed for run in runs for seed in run["seeds"]]
    return f"{min(seeds)}–{max(seeds)}"
