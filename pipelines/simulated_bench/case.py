"""Sealed cases: a machine as its owner describes it, with hidden changes; logs and descriptions, and separately the truth.

    schema = 1
    name = "case-07"
    base = "bench.toml"              # a bench recipe, beside or above this file
    [visible]                        # over the base: known and measured by the owner
    axes.boom.valve.deadband_positive = 0.12
    [hidden]                         # over the visible machine: hidden changes
    axes.slew.backlash = 0.0105
    [[effects]]                      # effects of these changes
    name = "backlash"
    target = "slew"

The nominal plant is fitted to step tests of the visible machine without noise, so that a case without hidden changes has
almost no gap. The truth of a hidden effect of the command stage is the best fit of the named effect to the noise-free motion;
the error of that fit is stored as ``model_error``. Geometry, backlash, swing and sensors are known exactly.
A hidden change with several effects (a hydraulic drive changes the spool as well as the load) lists all of them in
``effects``: they are fitted together.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from simulated_bench.contract_chain import KEYS, PARAMETERS
from simulated_bench.cylinder import drive_of, joint_of
from simulated_bench.machine import Truth
from simulated_bench.nominal import (
    BASIC,
    STEP_TESTS,
    STRIDE,
    CommandChain,
    fit_effects,
    fit_nominal,
    gravity_along,
    model_error,
    noise_free,
)
from simulated_bench.recipe import AXES, BenchRecipe, HiddenSettings
from simulated_bench.recipe_file import check_recipe
from simulated_bench.rigid_body import bodies_of
from simulated_bench.run import simulate
from simulated_bench.site_files import write_site_files
from simulated_bench.truth import describe_run
from simulated_bench.write import write
from sysid.config import Strict, parse_settings, read_toml
from sysid.errors import SettingsError, nearest


@dataclass(frozen=True)
class CaseSettings(Strict):
    """``CASE.toml``."""

    schema: Literal[1]
    name: str
    base: str
    visible: dict[str, Any]
    hidden: dict[str, Any]
    effects: tuple[HiddenSettings, ...] = ()


@dataclass(frozen=True)
class BenchCase:
    """The machine as its owner describes it, the real machine, and the effects of the difference."""

    name: str
    visible: BenchRecipe
    real: BenchRecipe
    effects: tuple[HiddenSettings, ...]


def load_case(path: Path) -> BenchCase:
    """Read and check a case.

    Raises:
        SettingsError: an unknown key or effect, or a machine that cannot be simulated.
    """
    values = {"visible": {}, "hidden": {}, **read_toml(path)}
    settings = parse_settings(values, CaseSettings, path)
    base = path.parent / settings.base
    common = {**read_toml(base), "name": settings.name}
    common.pop("hidden", None)
    visible = overlaid(common, settings.visible)
    real = overlaid(visible, settings.hidden)
    recipes = []
    for part, tables in (("visible", visible), ("hidden", real)):
        recipe = parse_settings(tables, BenchRecipe, f"{path}: {part}")
        check_recipe(recipe, f"{path}: {part}")
        recipes.append(recipe)
    for effect in settings.effects:
        if effect.name not in NAMES:
            raise SettingsError(f"{path}: effects", f"no effect {effect.name!r}", nearest(effect.name, NAMES))
        if effect.name.startswith("sensor_"):
            _EXACT[effect.name](recipes[1], effect.target)
            continue
        targets = _TARGETS.get(effect.name, AXES)
        if effect.target not in targets:
            raise SettingsError(f"{path}: effects", f"{effect.name} of {effect.target!r}", nearest(effect.target, targets))
    return BenchCase(settings.name, recipes[0], recipes[1], settings.effects)


def overlaid(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Tables merged key by key; values and lists of ``above`` replace those of ``below``."""
    merged = dict(below)
    for key, value in above.items():
        under = merged.get(key)
        merged[key] = overlaid(under, value) if isinstance(value, dict) and isinstance(under, dict) else value
    return merged


def write_case(case: BenchCase, out: Path, nominal: CommandChain | None = None) -> dict[str, Any]:
    """Write ``out/site`` (logs, machine, recipe) and ``out/truth/truth.json``; returns the truth.

    Args:
        nominal: result of :func:`fit_nominal` for ``case.visible``, where it is already known.
    """
    nominal = nominal or fit_nominal(case.visible)
    site, sealed = out / "site", out / "truth"
    described = {}
    parked = None
    for recording in case.real.recordings:
        run = simulate(case.real, recording)
        write(run, site / "logs" / recording.name)
        described[recording.name] = describe_run(run)
        if parked is None and not recording.is_calibration:
            parked = run.truth.joint[0]
    assert parked is not None
    gains = {name: float(nominal.gains[i]) for i, name in enumerate(AXES)}
    write_site_files(site, case.visible, gains, known_effects(case.visible, nominal), parked)
    motion = [each for each in case.real.recordings if not each.is_calibration]
    runs = noise_free(case.real, (*STEP_TESTS, *motion))
    repaired = fit_effects(case.real, nominal, case.effects, runs)
    effects = [describe(case, effect, nominal, repaired, runs) for effect in case.effects]
    sealed.mkdir(parents=True, exist_ok=True)
    truth: dict[str, Any] = {
        "schema": 1,
        "case": case.name,
        "seed": case.real.seed,
        "effects": effects,
        "model_error": {
            "nothing_hidden": model_error(case.visible, nominal, noise_free(case.visible, motion)),
            "before": model_error(case.real, nominal, runs[len(STEP_TESTS) :]),
            "after": model_error(case.real, repaired, runs[len(STEP_TESTS) :]),
        },
        "recordings": described,
    }
    (sealed / "truth.json").write_text(json.dumps(truth, indent=1) + "\n", "utf-8")
    return truth


def known_effects(visible: BenchRecipe, nominal: CommandChain) -> list[dict[str, Any]]:
    """Effects in the ``machine.toml`` of the site: the fitted command stage, and visible backlash, swing and elasticity."""
    found: list[dict[str, Any]] = []
    for i, axis in enumerate(AXES):
        for name in dict.fromkeys(key[0] for key in KEYS):
            places = [k for k, key in enumerate(KEYS) if key[0] == name]
            away = [abs(nominal.rows[i, k] - PARAMETERS[KEYS[k]][0]) / PARAMETERS[KEYS[k]][3] for k in places]
            if max(away) > (0.0 if name in BASIC else 0.01):
                values = {KEYS[k][1]: float(nominal.rows[i, k]) for k in places}
                found.append({"name": name, "target": axis, "parameters": values})
        if visible.axis(axis).backlash > 0.0:
            found.append({"name": "backlash", "target": axis, "parameters": {"width": visible.axis(axis).backlash}})
        if np.isfinite(visible.axis(axis).stiffness):
            compliance = {"compliance": 1.0 / visible.axis(axis).stiffness}
            found.append({"name": "joint_compliance", "target": axis, "parameters": compliance})
    if visible.gripper.length > 0.0:
        swing = {"length": visible.gripper.length, "damping_ratio": visible.gripper.damping_ratio}
        found.append({"name": "gripper_sway", "target": "tool", "parameters": swing})
    return found


def describe(
    case: BenchCase, effect: HiddenSettings, nominal: CommandChain, repaired: CommandChain, runs: tuple[Truth, ...]
) -> dict[str, Any]:
    """One hidden effect with its true parameters."""
    real, visible = case.real, case.visible
    if effect.name in _EXACT:
        return {
            "name": effect.name,
            "target": effect.target,
            "parameters": _EXACT[effect.name](real, effect.target),
            "exact": True,
        }
    if effect.name == "joint_compliance":
        fitted = {"compliance": _compliance(real, visible, effect.target, runs)}
        return {"name": effect.name, "target": effect.target, "parameters": fitted, "exact": False}
    if effect.name == "pump_flow_limit":
        return {"name": effect.name, "target": "machine", "parameters": {"limit": repaired.pump}, "exact": False}
    row = repaired.rows[AXES.index(effect.target)]
    values = {key[1]: float(row[k]) for k, key in enumerate(KEYS) if key[0] == effect.name}
    if effect.name == "stiction":  # the chain is fitted with seals that stick; of the spool the number is known
        valve = real.axis(effect.target).valve
        values["spool_breakaway"] = valve.silt - min(valve.deadband_positive, valve.deadband_negative)
    return {"name": effect.name, "target": effect.target, "parameters": values, "exact": False}


def _compliance(real: BenchRecipe, visible: BenchRecipe, axis: str, runs: tuple[Truth, ...]) -> float:
    """Deflection per gravity moment that fits the joint best, relative to its drive through the linkage [rad/(N·m)]."""
    i = AXES.index(axis)
    bodies = bodies_of(visible.masses, visible.geometry.boom, visible.geometry.stick, visible.gripper.length)
    drive = drive_of(real.axis(axis))
    above = below = 0.0
    for run in runs:
        for joint, place in zip(run.joint[:: 10 * STRIDE], run.drive[:: 10 * STRIDE, i], strict=True):
            moment = gravity_along(joint[None], bodies)[0, i - 1]
            above += moment * (joint_of(float(place), drive) - joint[i])
            below += moment * moment
    return above / below


def _sensor(key: str, field: str) -> Callable[[BenchRecipe, str], dict[str, Any]]:
    def values(recipe: BenchRecipe, target: str) -> dict[str, Any]:
        sensor = recipe.sensor(target)
        if sensor is None:
            raise SettingsError(f"case {recipe.name}", f"no sensor {target!r} that is off", "an entry in hidden.sensors")
        return {key: getattr(sensor, field)}

    return values


_EXACT: dict[str, Callable[[BenchRecipe, str], dict[str, Any]]] = {
    "backlash": lambda r, target: {"width": r.axis(target).backlash},
    "gripper_sway": lambda r, _: {"length": r.gripper.length, "damping_ratio": r.gripper.damping_ratio},
    "joint_offset": lambda r, target: {"offset": r.build.joint_offset.get(target, 0.0)},
    "link_length_error": lambda r, target: {"error": r.build.boom if target == "boom" else r.build.stick},
    "base_misalignment": lambda r, _: {"translation": list(r.capture.shift), "rotation": list(r.capture.tilt)},
    "sensor_bias": _sensor("bias", "bias"),
    "sensor_scale": _sensor("scale", "scale"),
    "sensor_quantisation": _sensor("step", "quantum"),
}
#: Valid targets of effects whose target is not any axis.
_TARGETS = {
    "gripper_sway": ("tool",),
    "base_misalignment": ("base",),
    "pump_flow_limit": ("machine",),
    "link_length_error": ("boom", "stick"),
}
#: Every effect that a case may hide.
NAMES = tuple(dict.fromkeys([*(key[0] for key in KEYS), "pump_flow_limit", "joint_compliance", *_EXACT]))
