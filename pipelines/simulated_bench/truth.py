"""The truth about the logs: effects under their contract names, clocks, occlusions."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from simulated_bench.recipe import AxisSettings, BenchRecipe, GripperSettings
from simulated_bench.run import Run
from sysid.errors import SettingsError, nearest

#: Settings that switch an effect of a valve off, by its contract name.
_NEUTRAL: dict[str, dict[str, float]] = {
    "input_delay": {"delay": 0.0},
    "first_order_lag": {"time_constant": 0.0},
    "valve_deadband": {"deadband_positive": 0.0, "deadband_negative": 0.0},
    "flow_saturation": {"saturation": math.inf},
    "asymmetric_gain": {"direction_ratio": 1.0},
}


def describe_effects(recipe: BenchRecipe) -> list[dict[str, Any]]:
    """Every effect that the recipe switches on: name, target, parameters, and whether it is hidden."""
    hidden = {(item.name, item.target) for item in recipe.hidden}
    effects = [effect for name, axis in recipe.axes.items() for effect in _axis_effects(name, axis)]
    if recipe.gripper.length > 0.0:
        sway = {"length": recipe.gripper.length, "damping_ratio": recipe.gripper.damping_ratio}
        effects.append({"name": "gripper_sway", "target": "tool", "parameters": sway})
    return [{**effect, "hidden": (effect["name"], effect["target"]) in hidden} for effect in effects]


def without_hidden(recipe: BenchRecipe) -> BenchRecipe:
    """The same machine and recordings with every hidden effect at its neutral setting.

    Raises:
        SettingsError: the recipe hides an effect that the simulated test bench does not have.
    """
    axes = dict(recipe.axes)
    gripper = recipe.gripper
    for item in recipe.hidden:
        if (item.name, item.target) == ("gripper_sway", "tool"):
            gripper = GripperSettings()
            continue
        if item.name not in (*_NEUTRAL, "backlash") or item.target not in axes:
            where = f"recipe {recipe.name}: hidden {item.name!r} of {item.target!r}"
            valid = nearest(item.name, (*_NEUTRAL, "backlash", "gripper_sway"))
            raise SettingsError(where, "no such effect", f"{valid} of an axis or the tool")
        axis = axes[item.target]
        if item.name == "backlash":
            axes[item.target] = replace(axis, backlash=0.0)
        else:
            axes[item.target] = replace(axis, valve=replace(axis.valve, **_NEUTRAL[item.name]))
    return replace(recipe, axes=axes, gripper=gripper, hidden=())


def _axis_effects(name: str, axis: AxisSettings) -> list[dict[str, Any]]:
    valve = axis.valve
    found: list[tuple[str, dict[str, float], bool]] = [
        ("input_delay", {"delay": valve.delay}, valve.delay > 0.0),
        ("first_order_lag", {"time_constant": valve.time_constant}, valve.time_constant > 0.0),
        (
            "valve_deadband",
            {"positive": valve.deadband_positive, "negative": valve.deadband_negative},
            valve.deadband_positive > 0.0 or valve.deadband_negative > 0.0,
        ),
        ("flow_saturation", {"limit": valve.saturation}, math.isfinite(valve.saturation)),
        ("asymmetric_gain", {"ratio": valve.direction_ratio}, valve.direction_ratio != 1.0),
        ("backlash", {"width": axis.backlash}, axis.backlash > 0.0),
    ]
    return [{"name": effect, "target": name, "parameters": values} for effect, values, present in found if present]


def describe_run(run: Run) -> dict[str, Any]:
    """The clock of one recording, its occlusions and confused markers, and the start of the drives in their backlash."""
    clock = run.capture.clock
    latency = run.recipe.capture.latency
    return {
        "start_ns": run.start_ns,
        "capture_clock": {
            "definition": "t_machine = t_capture * (1 + 1e-6 * skew_ppm) + offset_s, t_machine in s since start_ns",
            "offset_s": clock.offset - latency,
            "skew_ppm": clock.skew,
            "of_which_latency_s": -latency,
        },
        "drive_at_start": dict(zip(run.recipe.axes, map(float, run.truth.drive[0]), strict=True)),
        "dropouts": [{"body": d.body, "start": d.start, "end": d.end} for d in run.capture.dropouts],
        "swaps": [
            {"body": s.body, "markers": list(s.markers), "start": s.at, "end": s.at + s.duration}
            for s in run.recipe.capture.swaps
            if s.recording == run.recording.name
        ],
    }
