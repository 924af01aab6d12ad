"""The goals of electric arms beside the figures of today, of simulated and of measured machines."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from committed import markdown

Case = Mapping[str, Any]
#: Arms of the first goal.
ARMS = 20
#: Axes of the UR10e whose torque may be left to a tenth, and tolerance of its payload.
FIRST_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow")
LEFT, PAYLOAD = 0.1, 0.03
#: Names that a recording of the UR10e may have: friction of its joints, and the payload where it carries one.
FRICTION = ("coulomb_friction", "viscous_friction", "load_dependent_friction")


def goal_table(cases: Sequence[Case], measured: Mapping[str, Any], changes: Sequence[tuple[str, str, str, str]]) -> str:
    """Every goal, today's figure, and whether it is reached.

    Args:
        measured: figures and names of measured machines, as :mod:`arms.measured` gives them.
        changes: their figures beside those before, as of :func:`arms.measured.compared`.
    """
    rows = [*_arm(_of(cases, "arm")), *_servos(cases), *_poses(cases), *_drives(cases)]
    rows += [*_ur10e(measured), *_others(changes), _wrong(cases)]
    return markdown(("goal", "limit", "today", ""), [(*row[:3], "reached" if row[3] else "**missed**") for row in rows], "llll")


Row = tuple[str, str, str, bool]


def _arm(arms: Sequence[Case]) -> list[Row]:
    loaded = [c for c in arms if c["spread"] is not None]
    friction = _errors(arms, "friction")
    payload = [value for case in loaded for value in _errors([case], "payload")]
    ratios = _ratios(arms)
    return [
        ("six-axis arm: names right on every joint", f"{ARMS} arms", *_count(arms, _right, ARMS)),
        ("— friction of the joints", "≤ 5 %", *_within(friction, 0.05, "parameters")),
        ("— mass of the payload", "≤ 5 %", *_within(payload, 0.05, "payloads")),
        ("— force error, of the truth's", "≤ 1.2", *_at_most(ratios, 1.2)),
    ]


def _servos(cases: Sequence[Case]) -> list[Row]:
    plain, masses = _of(cases, "servo_sag", "plain"), _of(cases, "servo_sag", "urdf")
    arms = _of(cases, "servo_arm")
    right, wrong = sum(map(_right, arms)), sum(bool(c["wrong"]) for c in arms)
    count = f"{right} of {len(arms)}, {wrong} wrong"
    controlled = [
        ("arm of position servos, from its MJCF: right names", "90 %, 1 wrong", count, right >= 0.9 * len(arms) and wrong <= 1),
        ("— held-out error, of the encoders' noise", "≤ 1.2", *_at_most(_ratios(arms), 1.2)),
    ]
    return [
        *(controlled if arms else []),
        ("sagging servo without a URDF: a tie or no name", "all", *_count(plain, lambda c: bool(c["tie"]) and _right(c))),
        ("sagging servo with a URDF: every compliance named", "all", *_count(masses, _right)),
        ("— compliance", "≤ 5 %", *_within(_errors(masses, "joint_compliance"), 0.05, "named ones")),
    ]


def _poses(cases: Sequence[Case]) -> list[Row]:
    poses, eleven = _of(cases, "poses", ""), _of(cases, "poses", "eleven")
    seconds = [c["wall_seconds"] for c in eleven if c["wall_seconds"] is not None]
    return [
        ("500 poses, geometry and compliance together: right names", "all", *_count(poses, _right)),
        ("— held-out error, of the truth's", "≤ 1.3", *_at_most(_ratios(poses), 1.3)),
        ("11 joints × 400 poses, two cores", "≤ 60 s", *_at_most(seconds, 60.0, "{:.0f} s")),
        ("— right names", "all", *_count(eleven, _right)),
    ]


def _drives(cases: Sequence[Case]) -> list[Row]:
    force, velocity = _of(cases, "flexible", "force"), _of(cases, "flexible", "velocity")
    return [
        ("flexible drive, force axis: named, or its resonance stated", "all", *_count(force, _drive)),
        ("— its friction named too", "all", *_count(force, _right)),
        ("flexible drive, velocity axis: named, or its resonance stated", "all", *_count(velocity, _drive)),
        ("smooth friction: right form", "named or none", *_count(_of(cases, "smooth_friction"), lambda c: not c["wrong"])),
    ]


def _ur10e(measured: Mapping[str, Any]) -> list[Row]:
    figures, named = measured["figures"], measured["named"]
    runs = {run.partition(", ")[2]: effects for run, effects in named.items() if run.startswith("ur10e")}
    if not runs:
        return []
    bare = runs.pop("ur10e")
    axes = {text.split(", ")[2].partition(".")[0] for text in figures if text.startswith("UR10e, ur10e, ")}
    with_friction = [axis for axis in axes if f"coulomb_friction({axis})" in bare or f"viscous_friction({axis})" in bare]
    others = [e for e in bare if e.partition("(")[0] not in FRICTION]
    others += [e for effects in runs.values() for e in effects if e != "payload(tool)"]
    left = [figures[f"UR10e, ur10e, {axis}.command [relative]"] for axis in FIRST_JOINTS]
    mass = [figures.get(f"UR10e, {run}, mass of the payload [relative]", math.inf) for run in runs]
    return [
        ("UR10e, measured: friction of each joint named", "6 joints", f"{len(with_friction)}", len(with_friction) == len(axes)),
        ("— torque left on joints 1 to 3", "≤ 10 %", ", ".join(f"{100 * v:.1f} %" for v in left), max(left) <= LEFT),
        ("— error of the payload of 2.805 kg", "≤ 3 %", ", ".join(f"{100 * v:.1f} %" for v in mass), max(mass) <= PAYLOAD),
        ("— further names", "none", ", ".join(others) or "none", not others),
    ]


def _others(changes: Sequence[tuple[str, str, str, str]]) -> list[Row]:
    rows = []
    for machine in ("EMPS", "XL330", "SO-101", "TIAGo", "UR10"):
        own = [change for text, _, _, change in changes if text.startswith(f"{machine}, ")]
        counts = ", ".join(f"{own.count(kind)} {kind}" for kind in ("same", "better", "worse") if own.count(kind))
        rows.append((f"{machine}, measured: errors", "not worse", counts or "–", bool(own) and "worse" not in own))
    return rows


def _wrong(cases: Sequence[Case]) -> Row:
    count = sum(bool(c["wrong"]) for c in cases)
    return "all simulated machines: a wrong name", "0", f"{count} of {len(cases)}", not count


def _of(cases: Sequence[Case], row: str, variant: str | None = None) -> list[Case]:
    return [c for c in cases if c["row"] == row and (variant is None or c["variant"] == variant)]


def _right(case: Case) -> bool:
    return bool(case["outcome"] == "right")


def _drive(case: Case) -> bool:
    """Whether the spring has its name, or its resonance is stated within a tenth, and nothing is wrong."""
    named = not any(name.startswith("flexible_drive") for name, _ in case["missed"]) and case["outcome"] in (
        "right",
        "incomplete",
    )
    return not case["wrong"] and (named or (case["resonance"] is not None and case["resonance"] <= 0.1))


def _count(cases: Sequence[Case], test: Callable[[Case], bool], least: int = 1) -> tuple[str, bool]:
    """How many cases pass a test; all of them, and ``least`` at least, reach the goal."""
    good = sum(map(test, cases))
    return f"{good} of {len(cases)}", len(cases) >= least and good == len(cases)


def _errors(cases: Sequence[Case], part: str) -> list[float]:
    return [value for case in cases for key, value in case["errors"].items() if part in key]


def _ratios(cases: Sequence[Case]) -> list[float]:
    return [case["ratio"] for case in cases if case["ratio"] is not None and math.isfinite(case["ratio"])]


def _within(values: Sequence[float], limit: float, what: str) -> tuple[str, bool]:
    good = sum(value <= limit for value in values)
    largest = f", at most {100 * max(values):.1f} %" if values else ""
    return f"{good} of {len(values)} {what}{largest}", bool(values) and good == len(values)


def _at_most(values: Sequence[float], limit: float, form: str = "{:.2f}") -> tuple[str, bool]:
    """The largest value, and how many are within the limit where not all are."""
    if not values:
        return "–", False
    good = sum(value <= limit for value in values)
    some = "" if good == len(values) else f"; {good} of {len(values)} within"
    return f"at most {form.format(max(values))}{some}", good == len(values)
