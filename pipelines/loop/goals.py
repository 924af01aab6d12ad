"""The goals of closing the gap, and on how many machines they are reached."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from committed import markdown

Machine = Mapping[str, Any]

#: Largest error of a coordinate after the loop [mm]; relative to the repaired simulation, and to the true plant.
AFTER_MM, BESIDE_SIMULATION, BESIDE_TRUTH = 20.0, 1.3, 1.2
#: How much better naming should be than a controller made without it.
BETTER = 2.0
#: From the first to the second deployment [s].
LOOP_S = 1800.0


def goals(machines: Sequence[Machine]) -> str:
    """A row for each goal: what was to reach, the figure of every machine, and the number of machines that reach it.

    Errors after the loop are those of the plant of the last round in the comparison of controllers under the same noise.
    """
    after = [max(_other(machine, "repaired")) for machine in machines]
    simulated = [value / max(_last_simulated(machine)) for value, machine in zip(after, machines, strict=True)]
    truth = [value / max(_other(machine, "truth")) for value, machine in zip(after, machines, strict=True)]
    policy = [max(_other(machine, "policy_repaired")) for machine in machines]
    trained = [value / max(_other(machine, "policy_truth")) for value, machine in zip(policy, machines, strict=True)]
    kinematic = [value / other for value, other in zip(policy, after, strict=True)]
    between = [_to_second(machine) for machine in machines]
    rows = [
        (
            "error before, smallest and largest coordinate",
            "of the order of 75 / 80 / 73 mm",
            ", ".join(f"{min(_first(machine)):.0f}–{max(_first(machine)):.0f} mm" for machine in machines),
            "",
        ),
        _row("error after, largest coordinate", f"≤ {AFTER_MM:.0f} mm", after, "{:.1f} mm", AFTER_MM),
        _row("beside the repaired simulation", f"≤ {BESIDE_SIMULATION}", simulated, "{:.2f}", BESIDE_SIMULATION),
        _row("beside the controller of the true plant", f"≤ {BESIDE_TRUTH}", truth, "{:.2f}", BESIDE_TRUTH),
        _row("trained policy, largest coordinate", f"≤ {AFTER_MM:.0f} mm", policy, "{:.1f} mm", AFTER_MM),
        _row("beside inverse kinematics with the same plant", "≤ 1", kinematic, "{:.2f}", 1.0),
        _row("beside a policy trained for the true plant", f"≤ {BESIDE_TRUTH}", trained, "{:.2f}", BESIDE_TRUTH),
        _named(machines),
        *(
            _better(title, [(_other(machine, key), value) for machine, value in zip(machines, after, strict=True)])
            for title, key in (
                ("naming beside a guess of ±20 %", "guessed"),
                ("naming beside least squares without dead-bands", "lag_delay_gain"),
                ("naming beside least squares with one dead-band", "with_deadband"),
            )
        ),
        _row("wall time from first to second deployment", "≤ 30 min", between, "{:.0f} s", LOOP_S),
    ]
    return markdown(("goal", "to reach", "by machine", "reached"), rows, "llll")


def _row(title: str, bound: str, values: Sequence[float], form: str, limit: float) -> tuple[str, str, str, str]:
    return title, bound, ", ".join(form.format(value) for value in values), _count(value <= limit for value in values)


def _named(machines: Sequence[Machine]) -> tuple[str, str, str, str]:
    cells, reached = [], []
    for machine in machines:
        hidden, missed, wrong = len(machine["hidden"]), len(machine["missed"]), len(machine["wrong"])
        cells.append(f"{hidden - missed} of {hidden}, {wrong} wrong")
        reached.append(missed == 0 and wrong == 0)
    return "hidden effects named", "all, none wrong", "; ".join(cells), _count(reached)


def _better(title: str, pairs: Sequence[tuple[Sequence[float], float]]) -> tuple[str, str, str, str]:
    """Error without naming over the error after the loop; a path that the runner refuses counts as reached."""
    ratios = [max(without) / after if without else None for without, after in pairs]
    cells = ", ".join("refused" if ratio is None else f"{ratio:.1f} times" for ratio in ratios)
    return title, f"≥ {BETTER:.0f} times better", cells, _count(ratio is None or ratio >= BETTER for ratio in ratios)


def _count(reached: Any) -> str:
    found = list(reached)
    return f"{sum(found)} of {len(found)}"


def _first(machine: Machine) -> Sequence[float]:
    return _max_mm(machine["rounds"][0])


def _last_simulated(machine: Machine) -> Sequence[float]:
    return _max_mm(machine["rounds"][-1]["simulation"])


def _other(machine: Machine, name: str) -> Sequence[float]:
    return _max_mm(machine["compared"][name])


def _max_mm(figures: Mapping[str, Any]) -> Sequence[float]:
    """Largest error of each coordinate on the helix [mm]; empty for a path that the runner refused, or did not end."""
    values: Sequence[float] = figures["helix"]["max_mm"] if figures["helix"]["ended"] == "done" else ()
    return values


def _to_second(machine: Machine) -> float:
    rounds = machine["rounds"]
    return float(sum(rounds[0]["seconds"].values()) + (rounds[1]["seconds"]["deploy"] if len(rounds) > 1 else 0.0))
