"""Tables of docs/closing-the-gap.md from the result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from committed import markdown

#: Columns of the errors at the tool.
ERRORS = ("helix, max", "helix, RMSE", "circle, max")


def tables(result: Mapping[str, Any]) -> str:
    """Tracking errors by round, names by machine, and other controllers beside them."""
    machines = result["machines"]
    return "\n\n".join([_tracking(machines), _names(machines), _compared(machines)])


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
        )
        for machine in machines
        for number, row in enumerate(machine["rounds"])
    ]
    return markdown(head, rows, "llllllll")


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
    for machine in machines:
        last = len(machine["rounds"]) - 1
        found = {
            "nominal plant": machine["rounds"][0],
            f"repaired plant, round {last}": machine["rounds"][last],
            "dead time, lag and gain by least squares": machine["compared"]["lag_delay_gain"],
            "the same and one dead-band": machine["compared"]["with_deadband"],
            "true plant": machine["compared"]["truth"],
        }
        for name, row in found.items():
            figures = (*(shown(row["helix"].get(key)) for key in ("max_mm", "rmse_mm")), shown(row["circle"].get("max_mm")))
            refused = row["helix"]["ended"] == "refused"
            rows.append((machine["name"], name, *((f"refused: {row['helix']['why']}", "–", "–") if refused else figures)))
    return markdown(head, rows, "lllll")


def shown(values: Sequence[float] | None) -> str:
    """Coordinates x / y / z [mm]."""
    if values is None:
        return "–"
    return " / ".join(f"{value:.1f}" if value < 10.0 else f"{value:.0f}" for value in values)
