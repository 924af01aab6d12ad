"""Tables of docs/closing-the-gap.md from the result; the goals are in :mod:`loop.goals`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from committed import markdown
from loop.goals import goals

#: Columns of the errors at the tool.
ERRORS = ("helix, max", "helix, RMSE", "circle, max")


def tables(result: Mapping[str, Any]) -> str:
    """Goals, tracking errors by round, names by machine, other controllers beside them, and the gap by round."""
    machines = result["machines"]
    return "\n\n".join(part(machines) for part in (goals, _tracking, _names, _compared, _ratios, _gaps))


def summary(result: Mapping[str, Any]) -> str:
    """The table of README.md: largest error of the tool on the helix, by machine."""
    machines = result["machines"]
    head = ("controller made from", *(machine["name"] for machine in machines))
    rows = {name: [_worst(row) for row in found] for name, found in _controllers(machines).items()}
    return markdown(head, [(name, *cells) for name, cells in rows.items()], "l" * len(head))


def _controllers(machines: Sequence[Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any]]]:
    """Controller → its runs on each machine."""
    return {
        "nominal plant": [machine["rounds"][0] for machine in machines],
        "repaired plant, last round": [machine["rounds"][-1] for machine in machines],
        "nominal plant, ±20 % guessed": [machine["compared"]["guessed"] for machine in machines],
        "dead time, lag and gain by least squares": [machine["compared"]["lag_delay_gain"] for machine in machines],
        "the same and one dead-band": [machine["compared"]["with_deadband"] for machine in machines],
        "true plant": [machine["compared"]["truth"] for machine in machines],
    }


def _worst(row: Mapping[str, Any]) -> str:
    return "path refused" if row["helix"]["ended"] == "refused" else shown(row["helix"].get("max_mm"))


def _tracking(machines: Sequence[Mapping[str, Any]]) -> str:
    head = (
        "machine",
        "round",
        "named afterwards",
        "helix, max",
        "helix, RMSE",
        "circle, max",
        "helix simulated, max",
        "wall time",
        "processor time",
    )
    rows = [
        (
            machine["name"],
            str(number),
            ", ".join(f"`{each['name']}` {each['target']}" for each in row["named"]) or "–",
            *(shown(row["helix"].get(key)) for key in ("max_mm", "rmse_mm")),
            shown(row["circle"].get("max_mm")),
            shown(row["simulation"]["helix"].get("max_mm")),
            f"{sum(row['seconds'].values()):.0f} s",
            f"{row['cpu_seconds']:.0f} s" if "cpu_seconds" in row else "–",
        )
        for machine in machines
        for number, row in enumerate(machine["rounds"])
    ]
    return markdown(head, rows, "lllllll")


def _names(machines: Sequence[Mapping[str, Any]]) -> str:
    head = ("machine", "hidden", "named", "not named", "wrong names")
    rows = []
    for machine in machines:
        hidden = len(machine["hidden"])
        without = [tuple(each) for each in machine["adjusted"]]
        missed = [
            f"`{name}` {target}" + (" (its value is in the plant)" if (name, target) in without else "")
            for name, target in machine["missed"]
        ]
        wrong = [f"`{name}` {target}" for name, target in machine["wrong"]]
        named = str(hidden - len(machine["missed"]))
        rows.append((machine["name"], str(hidden), named, ", ".join(missed) or "–", ", ".join(wrong) or "–"))
    return markdown(head, rows, "lrrll")


def _compared(machines: Sequence[Mapping[str, Any]]) -> str:
    head = ("machine", "controller made from", *ERRORS)
    rows = []
    for number, machine in enumerate(machines):
        for name, found in _controllers(machines).items():
            row = found[number]
            figures = (*(shown(row["helix"].get(key)) for key in ("max_mm", "rmse_mm")), shown(row["circle"].get("max_mm")))
            refused = row["helix"]["ended"] == "refused"
            rows.append((machine["name"], name, *((f"refused: {row['helix']['why']}", "–", "–") if refused else figures)))
    return markdown(head, rows, "lllll")


def _ratios(machines: Sequence[Mapping[str, Any]]) -> str:
    """Largest coordinate of the error on the helix after the last round, relative to other runs."""
    head = ("machine", "before", "after", "after / simulated", "after / true plant", "guessed / after", "one dead-band / after")
    rows = []
    for machine in machines:
        first, last, compared = machine["rounds"][0], machine["rounds"][-1], machine["compared"]
        after = max(last["helix"]["max_mm"])
        pairs = ((after, last["simulation"]["helix"]), (after, compared["truth"]["helix"]))
        ratios = [after / max(other["max_mm"]) for after, other in pairs]
        others = [compared[name]["helix"].get("max_mm") for name in ("guessed", "with_deadband")]
        without = ["refused" if worst is None else f"{max(worst) / after:.1f}" for worst in others]
        figures = (f"{max(first['helix']['max_mm']):.0f} mm", f"{after:.1f} mm", *(f"{ratio:.2f}" for ratio in ratios))
        rows.append((machine["name"], *figures, *without))
    return markdown(head, rows, "l")


def _gaps(machines: Sequence[Mapping[str, Any]]) -> str:
    """RMSE of the free run at boom tip and tool, as the norm of the coordinates."""
    head = ("machine", "round", "boom tip: before", "after", "noise floor", "tool: before", "after", "noise floor")
    rows = []
    for machine in machines:
        for number, row in enumerate(machine["rounds"]):
            if "gap" not in row:
                continue
            cells = [
                f"{1e3 * math.hypot(*(row['gap'][kind][f'{point}.{letter}'] for letter in 'xyz')):.2f}"
                for point in ("ee", "tool")
                for kind in ("before", "after", "noise_floor")
            ]
            rows.append((machine["name"], str(number), *cells))
    return markdown(head, rows, "ll")


def shown(values: Sequence[float] | None) -> str:
    """Coordinates x / y / z [mm]."""
    if values is None:
        return "–"
    return " / ".join(f"{value:.1f}" if value < 10.0 else f"{value:.0f}" for value in values)
