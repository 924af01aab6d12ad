"""Sealed machines: a crane as its owner describes it, and a real one that hides five kinds of errors, drawn from a seed.

What is hidden: the sway of the gripper, backlash of two joints, unequal dead-bands of three valves, dead time of two valves,
and offsets of boom and stick, which hang lower than their sensors say. The magnitudes are those of docs/machine-facts.md.
``write_site`` writes the owner's description, ``write_truth`` the truth; the workflow reads the former only.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simulated_bench.case import known_effects, overlaid
from simulated_bench.contract_chain import KEYS, neutral_row
from simulated_bench.nominal import CommandChain
from simulated_bench.recipe import AXES, BenchRecipe
from simulated_bench.recipe_file import check_recipe
from simulated_bench.site_files import machine_toml, urdf
from sysid.config import parse_settings, read_toml

Tables = dict[str, Any]
BENCH = Path(__file__).resolve().parents[2] / "datasets" / "autolog" / "bench.toml"
#: Overlap of every valve by its data sheet, both sides (command).
OVERLAP = 0.10
#: Range of the wider side of the real dead-bands by axis, electronics included, and by how much the other side is narrower.
#: The valves of a 1:14 excavator have 0.43 to 0.67, sides differ by up to 0.09; the stick needs its speed on the helix.
OVERLAPS = {"slew": (0.43, 0.50), "boom": (0.43, 0.50), "stick": (0.25, 0.30)}
UNEQUAL = (0.04, 0.09)
#: Dead time beyond the described one, of the slew or the boom, and of the stick, whose hoses are longest [s]. Small machines
#: have up to 0.04 s altogether, a full-size excavator up to 0.7 s.
LATE = (0.04, 0.07)
STICK_LATE = (0.09, 0.12)
#: Offset of boom and stick, downwards [°].
LOWER = (0.7, 1.0)
#: What the owner describes, over the shipped crane: no backlash, no hanging tool, one overlap for all valves.
VISIBLE: Tables = {
    "name": "crane",
    "axes": {name: {"backlash": 0.0, "valve": {"deadband_positive": OVERLAP, "deadband_negative": OVERLAP}} for name in AXES},
    "gripper": {"length": 0.0, "damping_ratio": 0.0},
    "slew_sensor": {"error": 0.0},
    "capture": {"swaps": [], "exported_markers": []},
    "recordings": [],
}


@dataclass(frozen=True)
class HiddenEffect:
    """One hidden effect under its contract name; ``parameters`` are those of the machine, in SI."""

    name: str
    target: str
    parameters: dict[str, float]


@dataclass(frozen=True)
class SealedMachine:
    """A machine and what its owner knows of it.

    Args:
        visible, real: the described and the real machine.
        hidden: the effects of the difference.
    """

    seed: int
    visible: BenchRecipe
    real: BenchRecipe
    hidden: tuple[HiddenEffect, ...]


def draw_machine(seed: int) -> SealedMachine:
    """The sealed machine of a seed; equal seeds give equal machines."""
    draw = np.random.default_rng([29, seed])
    shipped = read_toml(BENCH)
    shipped.pop("hidden")
    visible = overlaid(shipped, {**VISIBLE, "seed": int(draw.integers(1, 2**31))})
    change, hidden = _hidden(visible, draw)
    return SealedMachine(seed, _parsed(visible), _parsed(overlaid(visible, change)), hidden)


def _hidden(visible: Tables, draw: np.random.Generator) -> tuple[Tables, tuple[HiddenEffect, ...]]:
    sway = {"length": _drawn(draw, 0.20, 0.30), "damping_ratio": _drawn(draw, 0.01, 0.08)}
    hidden = [HiddenEffect("gripper_sway", "tool", sway)]

    pinned = str(draw.choice(["boom", "stick"]))
    rack, pin = _drawn(draw, np.radians(0.4), np.radians(0.8)), _drawn(draw, 0.0005, 0.0010)
    hidden += [HiddenEffect("backlash", "slew", {"width": rack}), HiddenEffect("backlash", pinned, {"width": pin})]
    axes: Tables = {"slew": {"backlash": rack}, pinned: {"backlash": pin}}

    for name, (low, high) in OVERLAPS.items():
        wide = _drawn(draw, low, high)
        sides = wide, round(wide - _drawn(draw, *UNEQUAL), 5)
        positive, negative = sides if draw.random() < 0.5 else sides[::-1]
        hidden.append(HiddenEffect("valve_deadband", name, {"positive": positive, "negative": negative}))
        bands = {"valve": {"deadband_positive": positive, "deadband_negative": negative}}
        axes = overlaid(axes, {name: bands})

    for name, range_s in ((str(draw.choice(["slew", "boom"])), LATE), ("stick", STICK_LATE)):
        delay = round(visible["axes"][name]["valve"]["delay"] + _drawn(draw, *range_s), 5)
        hidden.append(HiddenEffect("input_delay", name, {"delay": delay}))
        axes = overlaid(axes, {name: {"valve": {"delay": delay}}})

    offsets = {name: -_drawn(draw, *np.radians(LOWER)) for name in ("boom", "stick")}
    hidden += [HiddenEffect("joint_offset", name, {"offset": offset}) for name, offset in offsets.items()]
    return {"gripper": sway, "axes": axes, "build": {"joint_offset": offsets}}, tuple(hidden)


def _drawn(draw: np.random.Generator, low: float, high: float) -> float:
    return round(float(draw.uniform(low, high)), 5)


def _parsed(tables: Tables) -> BenchRecipe:
    recipe = parse_settings(tables, BenchRecipe, "sealed machine")
    check_recipe(recipe, "sealed machine")
    return recipe


def write_site(machine: SealedMachine, folder: Path) -> None:
    """``machine.toml`` and URDF of the machine that the owner describes."""
    visible = machine.visible
    gains = {name: visible.axis(name).valve.gain for name in AXES}
    folder.mkdir(parents=True, exist_ok=True)
    known = known_effects(visible, _data_sheet(visible))
    (folder / "machine.toml").write_text(machine_toml(visible, gains, known), "utf-8")
    (folder / f"{visible.name}.urdf").write_text(urdf(visible), "utf-8")


def write_truth(machine: SealedMachine, path: Path) -> None:
    """The hidden effects, for the evaluation after the last round."""
    path.parent.mkdir(parents=True, exist_ok=True)
    hidden = [{"name": each.name, "target": each.target, "parameters": each.parameters} for each in machine.hidden]
    path.write_text(json.dumps({"schema": 1, "seed": machine.seed, "hidden": hidden}, indent=1) + "\n", "utf-8")


def _data_sheet(visible: BenchRecipe) -> CommandChain:
    """Dead time, lag and overlap of every valve as its data sheet gives them."""
    rows = []
    for name in AXES:
        valve, row = visible.axis(name).valve, neutral_row()
        row[KEYS.index(("input_delay", "delay"))] = valve.delay
        row[KEYS.index(("first_order_lag", "time_constant"))] = valve.time_constant
        row[KEYS.index(("valve_deadband", "positive"))] = valve.deadband_positive
        row[KEYS.index(("valve_deadband", "negative"))] = valve.deadband_negative
        rows.append(row)
    return CommandChain(np.array(rows), np.array([visible.axis(name).valve.gain for name in AXES]))
