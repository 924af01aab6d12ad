"""The figures as Markdown: rates beside their goals, what each hidden effect was called, and the cases that went wrong."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from committed import markdown

#: Rate, its description, and its goal.
GOALS: tuple[tuple[str, str, str], ...] = (
    ("false_naming_none", "nothing hidden: an effect is named", "≤ 1 %"),
    ("single_right", "one effect, at least three detection limits: right name and place, nothing else", "≥ 97 %"),
    ("single_described_right", "— the same without cases of which the best fit of the true effect explains less than half", ""),
    ("single_abstained", "— of these: no name", ""),
    ("single_wrong", "— of these: a wrong name", ""),
    ("single_below_limit_wrong", "one effect, less than that: a wrong name", ""),
    ("wrong_name", "any case: a wrong name", "≤ 2 %"),
    ("double_exact", "two effects: exactly these", "≥ 90 %"),
    ("triple_exact", "three effects: exactly these", "≥ 80 %"),
    ("unknown_not_misnamed", "an effect without a name: nothing named", "≥ 95 %"),
    ("unknown_described", "— of these: described as unnamed", ""),
    ("interval_coverage", "95 % intervals that contain the true value", "90–99 %"),
    ("interval_coverage_alike", "— of these, where machine and plant have the same formula", "90–99 %"),
    ("interval_coverage_unlike", "— of these, where the formulas differ: the best fit of the plant counts as true", ""),
    ("closed", "all hidden effects named and no other: 95 % of the closable gap closed, in every signal", "all"),
    ("failure", "no answer: a crash, or over the time limit", "0"),
)


def page_tables(result: Mapping[str, Any]) -> str:
    """Goals, figures and confusion as Markdown tables."""
    rates = []
    for key, text, goal in GOALS:
        rate = result["rates"][key]
        low, high = rate["wilson95"]
        rates.append((text, goal, _percent(rate["value"]), f"{_percent(low)} – {_percent(high)}", str(rate["cases"])))
    error, seconds = result["parameter_error"], result["seconds"]
    rates.append(("parameter error, median and 90th percentile", "≤ 1 %, ≤ 5 %", *_spread(error)))
    rates += [(f"— `{name}`", "≤ 15 %", *_spread(spread)) for name, spread in error["coarse"].items()]
    closed = f"{_percent(result['closed_min'])}, {_percent(result['closed_median'])}"
    taken = f"{_number(seconds['median'])}, {_number(seconds['max'])}"
    rates += [
        ("— all cases with a name: closed share of the signal that closes least; minimum, median", "≥ 95 %", closed, "", ""),
        ("seconds per case, median and maximum", "", taken, "", ""),
    ]
    called = [
        (hidden, ", ".join(f"{name} {count}" for name, count in sorted(counts.items(), key=lambda item: -item[1])))
        for hidden, counts in result["confusion"].items()
    ]
    failed = [
        (_conditions(case), _hides(case), _names(case["named"]), case["failure"] or case["verdict"], _explained(case))
        for case in result["judgements"]
        if case["failure"] or case["wrong"] or (case["due"] and not case["exact"])
    ]
    refused = [(lacks, str(each["hidden"]), str(each["other"])) for lacks, each in result.get("refusals", {}).items()]
    parts = [
        f"Tier `{result['tier']}`, {_count(result)}, seed {_seed(result)}, {result['date']}: `{result['command']}`.",
        markdown(("", "goal", "measured", "95 %", "cases"), rates, "llrlr"),
        "Names given to a single hidden effect:",
        markdown(("hidden", "named"), called, "ll"),
        "Why effects of a model that fits have no name, counted apart for effects that are hidden and for others:",
        markdown(("condition", "hidden effects", "others"), refused, "lrr"),
        "Cases with a wrong or incomplete answer:",
        "`explained`: share of the hidden error that the best fit of the true effect removes, where it is below 90 %.",
        markdown(("case", "hides", "named", "verdict", "explained"), failed, "llll"),
    ]
    return "\n\n".join(parts)


def _spread(values: Mapping[str, Any]) -> tuple[str, str, str]:
    return f"{_percent(values['median'])}, {_percent(values['p90'])}", "", str(values["count"])


def _count(result: Mapping[str, Any]) -> str:
    cases, listed = result["cases"], result.get("listed", result["cases"])
    return f"{cases} cases" if cases == listed else f"{cases} of {listed} cases, the others not run yet"


def _seed(result: Mapping[str, Any]) -> str:
    commit = result["commit"]
    return f"{result['seed']} (commit {commit[:8]})" if commit else f"{result['seed']}"


def _explained(case: Mapping[str, Any]) -> str:
    return _percent(case["explained"]) if case["explained"] < 0.9 else ""


def _conditions(case: Mapping[str, Any]) -> str:
    spec = case["spec"]
    parts = [spec["name"], f"{spec['family']} {spec['variant']}", spec["excitation"], f"noise {spec['noise']:g}"]
    if spec["disturbance"]:
        parts.append(f"disturbance {100.0 * spec['disturbance']:g} %")
    return ", ".join(parts)


def _hides(case: Mapping[str, Any]) -> str:
    parts = [f"{each['kind'].partition(':')[2]} × {each['factor']:g}" for each in case["spec"]["hidden"]]
    return ", ".join(parts) or "nothing"


def _names(names: Any) -> str:
    return ", ".join(f"{name}({target})" for name, target in names) or "–"


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{100.0 * value:.1f} %"


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.0f}"
