"""The owner's fitted plant of a machine: gain, dead time, lag and friction, fitted to tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from agreement.fitting import Unknown, errors
from hidden.foreign.description import machine_of
from hidden.foreign.excitation import Program, Take
from hidden.foreign.machines import FORCE_AXIS, Tables
from hidden.foreign.mjcf import mjcf
from hidden.foreign.simulate import quantised, simulate
from hidden.make import kept
from sysid.datasets import Recording
from sysid.machine import KnownEffect, Machine, machine_from_files
from sysid.plant import Plant, nominal_plant

Array = npt.NDArray[np.float64]

#: The owner's tests: programs and their length [s].
TESTS: tuple[tuple[Program, int], ...] = (("steps", 101), ("operator", 102), ("fourier", 103))
LENGTH = 60.0
#: Starting values of the dead time, in addition to the rated one [s].
DELAYS = (0.0, 0.003, 0.006, 0.012)


@dataclass(frozen=True)
class Owner:
    """Contents of the owner's ``machine.toml``: ``gains`` of velocity axes, and the known effects."""

    gains: dict[str, float]
    effects: tuple[KnownEffect, ...]

    def plant(self, tables: Tables) -> Plant:
        return nominal_plant(machine_of(tables, self.gains, self.effects))


def kept_owner(tables: Tables, folder: Path) -> Owner:
    """The owner of a machine; fitted once for each machine."""
    machine = mjcf(tables) if tables["family"].startswith("mujoco") else ""

    def fitted() -> dict[str, Any]:
        owner = owner_of(tables)
        effects = [{"name": e.name, "target": e.target, "parameters": dict(e.parameters)} for e in owner.effects]
        return {"gains": owner.gains, "effects": effects}

    found = kept(folder, machine + repr(sorted(tables.items())), fitted)
    return Owner(found["gains"], tuple(KnownEffect(**each) for each in found["effects"]))


def owner_of(tables: Tables) -> Owner:
    """Fit the plant to the owner's tests of the machine in ``tables``."""
    if tables["family"] in FORCE_AXIS:
        return _pushed(tables)
    tests = [recorded(tables, Take(program, seed, LENGTH, program)) for program, seed in TESTS]
    gains, known = {}, list[KnownEffect]()
    for name in tables["axes"]:
        gain, effects = fitted_axis(tables, name, tests)
        gains[name] = gain
        known += effects
    tool = tables.get("tool", {"length": 0.0})
    if tool["length"] > 0.0:
        known.append(KnownEffect("gripper_sway", "tool", {"length": tool["length"], "damping_ratio": tool["damping_ratio"]}))
    return Owner(gains, tuple(known))


def fitted_axis(
    tables: Tables, name: str, tests: Sequence[Recording], also: Sequence[Unknown] = ()
) -> tuple[float, list[KnownEffect]]:
    """Gain, and dead time, lag, overlap and ``also`` of one axis, by least squares of free runs over the tests."""
    about = tables["axes"][name]
    velocity = tables["family"] == "mujoco_crane"
    unknowns = [
        Unknown("input_delay", name, {"delay": about["delay"] + 1e-3}),
        Unknown("first_order_lag", name, {"time_constant": about["lag"]}),
    ]
    if velocity:
        unknowns.insert(0, Unknown("gain_error", name, {"ratio": 1.0}))
        if about["friction"] > 0.0:
            unknowns.append(Unknown("valve_deadband", name, dict.fromkeys(("positive", "negative"), about["friction"])))
    unknowns = [each for each in unknowns if each.name not in {other.name for other in also}] + list(also)
    alone = nominal_plant(one_axis(tables, name, about["gain"] if velocity else 1.0))
    found = best_fit(alone, unknowns, tests, f"{name}.joint")
    gain = 1.0
    if velocity:
        (ratio,) = (effect for effect in found if effect.name == "gain_error")
        gain = about["gain"] * float(ratio.parameters["ratio"])  # type: ignore[arg-type]
    return gain, [effect for effect in found if effect.name != "gain_error"]


def one_axis(tables: Tables, name: str, gain: float) -> Machine:
    """The axis as a machine of its own."""
    about = tables["axes"][name]
    velocity = tables["family"] == "mujoco_crane"
    low, high = about["limits"]
    lines = ["schema = 1", 'name = "axis"', f"rate_hz = {tables['rate']}", "[[axes]]", f'name = "{name}"', 'drives = "joint"']
    lines += [f'actuation = "{"velocity" if velocity else "position"}"', f"limits = [{low}, {high}]"]
    lines += [f"gain = {gain}"]
    return machine_from_files({"machine.toml": "\n".join(lines) + "\n"}, name)


def best_fit(plant: Plant, unknowns: Sequence[Unknown], tests: Sequence[Recording], signal: str) -> list[KnownEffect]:
    """The effects at their least-squares values, from several dead times: every sample of one has a minimum of its own."""
    guess = np.concatenate([unknown.start for unknown in unknowns])
    low, high = np.concatenate([unknown.bounds for unknown in unknowns]).T
    sizes = np.maximum(np.abs(guess), 1e-3)

    def effects_at(x: Array) -> list[KnownEffect]:
        found, place = [], 0
        for unknown in unknowns:
            found.append(unknown.at(x[place : place + len(unknown.start)] * sizes[place : place + len(unknown.start)]))
            place += len(unknown.start)
        return found

    def residuals(x: Array) -> Array:
        tried = plant
        for effect in effects_at(x):
            tried = tried.with_effect(effect)
        return errors(tried, tests, (signal,))

    ends = (low / sizes + 1e-9, high / sizes - 1e-9)
    delays = [k for k, unknown in enumerate(unknowns) if unknown.name == "input_delay"]
    tries = []
    for shift in DELAYS if delays else (0.0,):
        start = guess.copy()
        start[delays] += shift
        begin = np.clip(start / sizes, ends[0] + 1e-6, ends[1] - 1e-6)
        tries.append(least_squares(residuals, begin, bounds=ends, diff_step=1e-4, max_nfev=30))
    best = min(tries, key=lambda each: each.cost).x
    return effects_at(np.asarray(least_squares(residuals, best, bounds=ends, diff_step=1e-6, max_nfev=30).x))


def _pushed(tables: Tables) -> Owner:
    """Inertia and friction of a force axis are in its data sheet."""
    axis = FORCE_AXIS[tables["family"]]
    known = [KnownEffect("viscous_friction", axis, {"coefficient": tables["viscous"]})]
    if tables["coulomb"] > 0.0:
        known.append(KnownEffect("coulomb_friction", axis, {"force": tables["coulomb"]}))
    return Owner({}, tuple(known))


def recorded(tables: Tables, take: Take) -> Recording:
    """A recording without noise, as its sensors show it."""
    return Recording(take.name, quantised(tables, simulate(tables, take)), tables["rate"])
