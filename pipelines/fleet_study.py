"""Twenty simulated servo arms of one type: are those that differ named, is drift noticed soon, how often is an alarm false?

    python pipelines/fleet_study.py --work WORK --machines 0:5     (and so on: the workspace keeps what is done)
    python pipelines/fleet_study.py --work WORK --publish

Differences and drifts follow from the seed; the workflow has the logs alone. See reports/fleet/README.md.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from committed import ROOT, markdown, provenance, write_result, write_tables
from fleet.false_alarms import measured, pooled
from fleet.sealed import BEFORE, CURRIE, FIRST, NAMED, SECONDS, HiddenMachine, later, sealed, write_first
from sysid.config import parse_settings
from sysid.datasets import ingest
from sysid.fleet import fleet_gap
from sysid.fleet.drift import drifts
from sysid.fleet.effects import FleetEffect, ParameterHistory, union
from sysid.fleet.estimates import estimate, name_effects
from sysid.workspace import open_workspace

SEED = 20261126
RESULT, PAGE = ROOT / "reports/fleet/result.json", ROOT / "reports/fleet/README.md"
#: Accepted false alarms of a machine in 1000 hours.
FALSE_ALARMS = 1.0
GOALS = {"differing": 0.9, "minutes": 10.0, "false alarms in 1000 h": 1.0}


def name_machine(machine: HiddenMachine, work: Path, seed: int) -> None:
    """First logs → dataset → names, which the workspace keeps."""
    kept = work / "workspace"
    first = write_first(machine, work / "logs" / machine.name, seed)
    dataset = ingest(first, kept, name=machine.name)
    name_effects(str(kept), dataset.reference, None)


def watch_machine(machine: HiddenMachine, effects: Sequence[FleetEffect], work: Path, seed: int) -> dict[str, Any]:
    """The values of the effects of the type in all recordings, and their drifts; kept for the next call."""
    kept = work / "machines" / f"{machine.name}.json"
    chosen = [asdict(effect) for effect in effects]
    if kept.exists() and (known := json.loads(kept.read_text()))["effects"] == json.loads(json.dumps(chosen)):
        return dict(known)
    place = open_workspace(work / "workspace")
    dataset = place.dataset(f"{machine.name}@1")
    plant = place.plant(dataset)
    before, after = estimate(dataset, plant, effects), estimate(dataset, plant, effects, later=later(machine, seed))
    histories = [_joined(one, more) for one, more in zip(before, after, strict=True)]
    found = drifts(histories, FALSE_ALARMS / 1000.0)
    values = {"effects": chosen, "histories": [asdict(h) for h in histories], "drifts": [asdict(d) for d in found]}
    kept.parent.mkdir(parents=True, exist_ok=True)
    kept.write_text(json.dumps(values))
    return dict(json.loads(kept.read_text()))


def _joined(one: ParameterHistory, more: ParameterHistory) -> ParameterHistory:
    parts = {key: getattr(one, key) + getattr(more, key) for key in ("recordings", "ends", "values", "deviations")}
    return replace(one, **parts)


def study(machines: list[HiddenMachine], work: Path, seed: int, hours: int) -> dict[str, Any]:
    """The scores."""
    found = fleet_gap(work / "workspace", [f"{m.name}@1" for m in machines])
    fleet = json.loads(json.dumps(found.to_json()))
    watched = {m.name: watch_machine(m, found.effects, work, seed) for m in machines}
    calm = [_calm(m, watched[m.name]) for m in machines]
    complete = [histories for histories in calm if len(histories) == len(NAMED)]
    values, deviations, neighbours = pooled(complete)
    spread = {h.effect.name: [] for h in complete[0]}
    for histories in complete:
        for history in histories:
            spread[history.effect.name].append(np.var(history.values, ddof=1))
    sigma = {name: float(np.mean(found) ** 0.5) for name, found in spread.items()}
    rows = [_row(m, watched[m.name], fleet, sigma) for m in machines]
    alarms = measured(complete[0], (values, deviations), SECONDS, hours, seed)
    differing, drifting = [r for r in rows if r["differs"]], [r for r in rows if r["drift"]]
    minutes = [r["minutes"] for r in drifting]
    return {
        "settings": {"machines": len(machines), "seconds": SECONDS, "first": FIRST, "before": BEFORE},
        "summary": {
            "named_all": sum(r["named"] == sorted(effect for effect, _ in NAMED.values()) for r in rows),
            "differing": len(differing),
            "differing_named": sum(r["differs_named"] for r in differing),
            "falsely_different": sum(len(r["falsely_different"]) for r in rows),
            "drifting": len(drifting),
            "noticed": sum(m is not None for m in minutes),
            "noticed_in_ten_minutes": sum(m is not None and m <= GOALS["minutes"] for m in minutes),
            "worst_minutes": max((m for m in minutes if m is not None), default=None),
            "false_drifts": sum(r["false_drifts"] for r in rows),
            "hours": sum(FIRST + m.later for m in machines) * SECONDS / 3600.0,
            "calm_hours": sum(len(h[0].values) for h in complete) * SECONDS / 3600.0,
            "neighbours": neighbours,
        },
        "deviation_of_a_recording": sigma,
        "false_alarms": alarms,
        "machines": rows,
    }


def _histories(result: dict[str, Any]) -> dict[tuple[str, str], ParameterHistory]:
    found = [parse_settings(values, ParameterHistory, "history") for values in result["histories"]]
    return {(h.effect.name, h.parameter): h for h in found}


def _calm(machine: HiddenMachine, result: dict[str, Any]) -> list[ParameterHistory]:
    """The planted parameters over the recordings in which none of them changes."""
    last = FIRST + BEFORE if machine.drift is not None else FIRST + machine.later
    found = []
    for key in NAMED.values():
        history = _histories(result).get(key)
        if history is not None:
            kept = [k for k, name in enumerate(history.recordings) if _number(name) < last]
            parts = {
                key: tuple(getattr(history, key)[k] for k in kept) for key in ("recordings", "ends", "values", "deviations")
            }
            found.append(replace(history, **parts))
    return found if len({h.recordings for h in found}) == 1 else []


def _number(recording: str) -> int:
    return int(recording.partition("#")[0].removeprefix("run-"))


def _row(machine: HiddenMachine, result: dict[str, Any], fleet: dict[str, Any], sigma: dict[str, float]) -> dict[str, Any]:
    deviating = {(d["effect"]["name"], d["parameter"]) for d in fleet["differences"] if machine.name in d["deviating"]}
    planted = {NAMED[machine.differs]} if machine.differs is not None else set()
    named = sorted(effect["name"] for effect in fleet["effects"] if machine.name in effect["named_on"])
    row: dict[str, Any] = {
        "machine": machine.name,
        "named": named,
        "differs": machine.differs,
        "differs_named": bool(planted & deviating),
        "falsely_different": sorted("/".join(key) for key in deviating - planted),
        "drift": None,
        "limit": None,
        "passed_min": None,
        "minutes": None,
    }
    own = NAMED[machine.drift.parameter] if machine.drift is not None else None
    histories = _histories(result)
    found = [(d, (d["effect"]["name"], d["parameter"])) for d in result["drifts"]]
    begin = FIRST + BEFORE
    right = [d for d, key in found if key == own and _number(d["noticed"]) >= begin]
    row["false_drifts"] = len(found) - len(right)
    if machine.drift is None or own not in histories:
        row["drift"] = machine.drift.parameter if machine.drift is not None else None
        return row
    drift = machine.drift
    limit = max(histories[own].negligible, CURRIE * sigma[own[0]])
    passed = next((k for k in range(10_000) if drift.change(k) >= limit), None)
    row |= {"drift": drift.parameter, "kind": "step" if drift.rate == 0.0 else "growth", "limit": limit}
    if passed is None:
        return row
    row["passed_min"] = (begin + passed) * SECONDS / 60.0
    if right:
        noticed = min(_number(d["noticed"]) for d in right) + 1
        row["minutes"] = noticed * SECONDS / 60.0 - row["passed_min"]
    return row


def tables(result: dict[str, Any]) -> str:
    """Tables of the page."""
    s, alarms = result["summary"], result["false_alarms"]
    drifts_of = f"of {s['drifting']}"
    hours = f"{alarms['hours']} h of drawn values"
    share = markdown(
        ("figure", "goal", "found"),
        [
            (
                "machines on which exactly the three effects are named",
                "–",
                f"{s['named_all']} of {result['settings']['machines']}",
            ),
            ("differing machines found, with their parameter", "≥ 90 %", f"{s['differing_named']} of {s['differing']}"),
            ("machines called different that do not differ", "0", f"{s['falsely_different']}"),
            ("drifts noticed", "all", f"{s['noticed']} {drifts_of}"),
            ("noticed within 10 min of motion after the detection limit", "all", f"{s['noticed_in_ten_minutes']} {drifts_of}"),
            ("longest time until noticed", "≤ 10 min", _minutes(s["worst_minutes"])),
            (f"drifts reported that are not there, in {s['hours']:.1f} h of recordings", "0", f"{s['false_drifts']}"),
            (f"false alarms of the chart in {hours}", "≤ 1 in 1000 h", _rate(alarms["chart"], alarms, "chart")),
            ("of these beyond a negligible change", "≤ 1 in 1000 h", _rate(alarms["reported"], alarms, "reported")),
            ("correlation of neighbouring recordings", "0", f"{s['neighbours']:+.3f}"),
        ],
        "lrr",
    )
    drifting = markdown(
        ("machine", "parameter", "kind", "passed its limit after", "noticed after another"),
        [
            (r["machine"], r["drift"], r.get("kind", ""), _minutes(r["passed_min"]), _minutes(r["minutes"]))
            for r in result["machines"]
            if r["drift"]
        ],
        "lllrr",
    )
    return f"{share}\n\n{drifting}"


def _rate(count: int, alarms: dict[str, Any], key: str) -> str:
    return f"{count} (at most {alarms[f'{key}_upper95_per_1000_h']:.2f} in 1000 h, 95 %)"


def _minutes(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f} min"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--machines", default="0:20", help="first:last+1")
    parser.add_argument("--watch", action="store_true", help="also estimate their later recordings")
    parser.add_argument("--hours", type=int, default=10_000, help="of drawn values, for false alarms")
    parser.add_argument("--publish", action="store_true", help="score these machines")
    options = parser.parse_args()
    begin, _, end = options.machines.partition(":")
    machines = sealed(options.seed)[int(begin) : int(end)]
    for machine in machines:
        name_machine(machine, options.work, options.seed)
        print(machine.name, flush=True)
    if options.watch:
        named = [name_effects(str(options.work / "workspace"), f"{m.name}@1", None) for m in machines]
        for machine in machines:
            watch_machine(machine, union(item.effects for item in named), options.work, options.seed)
    if options.publish:
        words = f"--seed {options.seed} --machines {options.machines} --hours {options.hours} --publish"
        head = provenance(f"python pipelines/fleet_study.py --work WORK {words}", options.seed)
        result = {**head, **study(machines, options.work, options.seed, options.hours)}
        write_result(RESULT, result)
        write_tables(PAGE, tables(result), "pipelines/fleet_study.py")


if __name__ == "__main__":
    main()
