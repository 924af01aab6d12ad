"""What a machine hides, as parameters in the contract's definitions.

Where plant and simulator share a formula the value is a number of the machine (``exact``); elsewhere it is the value at which
the plant's formula comes closest to what the machine really did, without noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from agreement.fitting import Unknown
from hidden.foreign.excitation import Take
from hidden.foreign.machines import FORCE_AXIS, Tables
from hidden.foreign.mjcf import RINGING_LINK, spring_stiffness
from hidden.foreign.owner import Owner, best_fit, one_axis, recorded
from hidden.kinds import Kind
from sysid.datasets import Recording
from sysid.machine import KnownEffect
from sysid.plant import Plant, free_run, nominal_plant

#: Effects whose equation in the simulator differs from the plant's.
FITTED = ("first_order_lag", "valve_deadband", "backlash", "oil_compressibility", "input_delay", "command_rate_limit")
#: Number of recordings for a fit and its error.
SEEN = 3


def truths(kind: Kind, known: Tables, real: Tables, owner: Owner, takes: Sequence[Take]) -> list[dict[str, Any]]:
    """Effects of a kind: ``name``, ``target``, ``parameters``, whether they are ``exact``, and the ``side`` of a backlash."""
    found = []
    for name, target in kind.named:
        exact = name not in FITTED
        values = numbers(name, target, known, real, owner)
        if not exact:
            values = fitted(name, target, values, real, owner, takes)
        entry = {"name": name, "target": target, "parameters": values, "exact": exact}
        if name in ("backlash", "joint_compliance"):
            behind = name == "joint_compliance" and known["family"] == "mujoco_crane"
            entry["side"] = "structure" if behind else "drive"
        found.append(entry)
    return found


def numbers(name: str, target: str, known: Tables, real: Tables, owner: Owner) -> dict[str, Any]:
    """Settings of the machine; for a fitted effect the start of the fit."""
    if target.partition(".")[2] == "joint" and name.startswith("sensor_"):
        sensor = real["sensors"][target]
        key, source = {
            "sensor_bias": ("bias",) * 2,
            "sensor_scale": ("scale",) * 2,
            "sensor_quantisation": ("step", "quantum"),
        }[name]
        return {key: sensor[source]}
    if known["family"] in FORCE_AXIS:
        return _pushed(name, known, real)
    build, tool = real.get("build", {}), real.get("tool", {})
    if name in ("base_misalignment", "gripper_sway", "joint_offset", "link_length_error"):
        return {
            "base_misalignment": lambda: {key: build[key] for key in ("translation", "rotation")},
            "gripper_sway": lambda: {key: tool[key] for key in ("length", "damping_ratio")},
            "joint_offset": lambda: {"offset": build["turn"][target]},
            "link_length_error": lambda: {"error": build["longer"][target]},
        }[name]()
    axis, before = real["axes"][target], known["axes"][target]
    known_effects = {(effect.name, effect.target): effect.parameters for effect in owner.effects}

    def shifted(effect: str, key: str, setting: str) -> dict[str, float]:
        """The owner's fitted value plus the change of the setting."""
        return {key: float(known_effects[effect, target][key]) + axis[setting] - before[setting]}  # type: ignore[arg-type]

    values = {
        "input_delay": lambda: shifted("input_delay", "delay", "delay"),
        "first_order_lag": lambda: shifted("first_order_lag", "time_constant", "lag"),
        "command_rate_limit": lambda: {"rate": axis["slew_rate"]},
        "backlash": lambda: {"width": axis["play"]},
        "joint_compliance": lambda: {"compliance": axis["compliance"]},
        "gain_error": lambda: {"ratio": axis["gain"] / owner.gains[target]},
        "asymmetric_gain": lambda: {"ratio": axis["ratio"]},
        "flow_saturation": lambda: {"limit": axis["saturation"]},
        "valve_deadband": lambda: dict.fromkeys(("positive", "negative"), axis["friction"]),
        "internal_leakage": lambda: {"rate": -axis["push"] * axis["gain"]},
        "oil_compressibility": lambda: {
            "frequency": math.sqrt(spring_stiffness(axis) / RINGING_LINK) / (2.0 * math.pi),
            "damping_ratio": axis["spring"][1],
        },
    }
    return values[name]()


def _pushed(name: str, known: Tables, real: Tables) -> dict[str, float]:
    values = {
        "coulomb_friction": lambda: {"force": real["coulomb"]},
        "viscous_friction": lambda: {"coefficient": real["viscous"]},
        "inertia_error": lambda: {"ratio": real["inertia"] / known["inertia"]},
        "load_bias": lambda: {"force": real["load"]},
        # In addition to the known Coulomb friction.
        "stribeck_friction": lambda: {
            "static_force": real["lugre"][2],
            "coulomb_force": real["lugre"][1],
            "stribeck_velocity": real["lugre"][3],
        },
    }
    return values[name]()


def fitted(
    name: str, target: str, guess: dict[str, Any], real: Tables, owner: Owner, takes: Sequence[Take]
) -> dict[str, float]:
    """Best fit of the plant's formula to the machine; other effects as in the owner's plant."""
    about = [effect for effect in owner.effects if effect.target == target and effect.name != name]
    plant = nominal_plant(one_axis(real, target, owner.gains.get(target, 1.0)))
    for effect in about:
        plant = plant.with_effect(effect)
    tests = [recorded(real, take) for take in takes[:SEEN]]
    (found,) = best_fit(plant, [Unknown(name, target, guess)], tests, f"{target}.joint")
    return {key: float(value) for key, value in found.parameters.items()}  # type: ignore[arg-type]


def model_error(
    known: Tables, real: Tables, owner: Owner, effects: Sequence[dict[str, Any]], takes: Sequence[Take]
) -> dict[str, dict[str, float]]:
    """RMSE by signal of noise-free free runs: without hidden effects, with them, and with them in the plant as well."""
    plant = owner.plant(known)
    named = plant
    for effect in effects:
        named = named.with_effect(KnownEffect(effect["name"], effect["target"], effect["parameters"], effect.get("side")))
    still = [recorded(known, take) for take in takes[:SEEN]]
    moved = [recorded(real, take) for take in takes[:SEEN]]
    return {"nothing_hidden": _rmse(plant, still), "before": _rmse(plant, moved), "after": _rmse(named, moved)}


def _rmse(plant: Plant, recordings: Sequence[Recording]) -> dict[str, float]:
    squares: dict[str, list[float]] = {}
    for recording in recordings:
        run = free_run(plant, recording)
        for signal in recording.signals:
            if signal in run and not signal.endswith(".command"):
                squares.setdefault(signal, []).append(float(np.nanmean((run[signal] - recording.values(signal)) ** 2)))
    return {signal: math.sqrt(float(np.mean(values))) for signal, values in squares.items()}
