"""Tables of reports/loop/README.md from the result; the goals are in :mod:`loop.goals`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from committed import markdown
from loop.goals import goals

#: Compared controllers, by their key in the result.
CONTROLLERS = {
    "nominal": "nominal plant",
    "repaired": "repaired plant, last round",
    "guessed": "nominal plant, ±20 % guessed",
    "lag_delay_gain": "dead time, lag and gain by least squares",
    "with_deadband": "the same and one dead-band",
    "truth": "true plant",
    "policy_nominal": "nominal plant, trained policy",
    "policy_repaired": "repaired plant, last round, trained policy",
    "policy_truth": "true plant, trained policy",
}
#: Columns of the errors at the tool.
ERRORS = ("helix, max", "helix, RMSE", "circle, max")


def tables(result: Mapping[str, Any]) -> str:
    """Goals, tracking errors by round, names by machine, other controllers beside them, and the gap by round."""
    machines = result["machines"]
    return "\n\n".join(part(machines) for part in (goals, rounds_table, _names, _compared, _gaps))


def summary(result: Mapping[str, Any]) -> str:
    """The table of README.md: largest error of the tool on the helix, by machine."""
    machines = result["machines"]
    head = ("controller made from", *(machine["name"] for machine in machines))
    rows = {name: [_worst(row) for row in found] for name, found in _controllers(machines).items()}
    return markdown(head, [(name, *cells) for name, cells in rows.items()], "l" * len(head))


def _controllers(machines: Sequence[Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any]]]:
    """Controller → its runs on each machine."""
    return {title: [machine["compared"][key] for machine in machines] for key, title in CONTROLLERS.items()}


def _worst(row: Mapping[str, Any]) -> str:
    ended = row["helix"]["ended"]
    return shown(row["helix"]["max_mm"]) if ended == "done" else "path refused" if ended == "refused" else "stopped by a check"


def rounds_table(machines: Sequence[Mapping[str, Any]]) -> str:
    """Tracking errors by round, what was named after it, and its time; proposed recordings where there are any."""
    rows = [(machine["name"], str(number), row) for machine in machines for number, row in enumerate(machine["rounds"])]
    head = ["machine", "round", *ERRORS, "helix simulated, max", "named afterwards", "wall time", "processor time"]
    proposed = any(row.get("experiments") for _, _, row in rows)
    cells = [
        [
            name,
            number,
            *(shown(row["helix"].get(key)) for key in ("max_mm", "rmse_mm")),
            shown(row["circle"].get("max_mm")),
            shown(row["simulation"]["helix"].get("max_mm")),
            ", ".join(f"`{each['name']}` {each['target']}" for each in row["named"]) or "–",
            f"{sum(row['seconds'].values()):.0f} s",
            f"{row['cpu_seconds']:.0f} s" if "cpu_seconds" in row else "–",
            *([", ".join(row["experiments"]) or "–"] if proposed else []),
        ]
        for name, number, row in rows
    ]
    return markdown([*head, *(["proposed recordings made"] if proposed else [])], cells, "lllllllrr" + "l" * proposed)


def _names(machines: Sequence[Mapping[str, Any]]) -> str:
    head = ("machine", "hidden", "named", "not named", "wrong names")
    rows = []
    for machine in machines:
        hidden = len(machine["hidden"])
        without = [tuple(each) for each in machine["adjusted"]]
        missed = [
            f"`{name}` {target}" + (" (adjusted without a name)" if (name, target) in without else "")
            for name, target in machine["missed"]
        ]
        wrong = [f"`{name}` {target}" for name, target in machine["wrong"]]
        named = str(hidden - len(machine["missed"]))
        rows.append((machine["name"], str(hidden), named, ", ".join(missed) or "–", ", ".join(wrong) or "–"))
    return markdown(head, rows, "lrrll")


def _compared(machines: Sequence[Mapping[str, Any]]) -> str:
    head = ("machine", "controller made from", "helix, max", "helix, RMSE")
    rows = []
    for number, machine in enumerate(machines):
        for name, found in _controllers(machines).items():
            helix = found[number]["helix"]
            done = helix["ended"] == "done"
            why = f"{helix['ended']}: {helix.get('why', '')}"
            figures = [shown(helix[key]) for key in ("max_mm", "rmse_mm")] if done else [why, "–"]
            rows.append((machine["name"], name, *figures))
    return markdown(head, rows, "llll")


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
