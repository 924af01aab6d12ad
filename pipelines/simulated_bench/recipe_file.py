"""Reading and checking of a bench recipe."""

from __future__ import annotations

import math
from pathlib import Path

from simulated_bench.programs import check_script
from simulated_bench.recipe import AXES, AxisSettings, BenchRecipe, CylinderSettings
from sysid.config import load_settings
from sysid.errors import SettingsError, nearest


def load_recipe(path: Path) -> BenchRecipe:
    """Read and check a bench recipe.

    Raises:
        SettingsError: an unknown key, a missing axis, an invalid value.
    """
    recipe = load_settings(path, BenchRecipe)
    check_recipe(recipe, path)
    return recipe


def check_recipe(recipe: BenchRecipe, where: object) -> None:
    """Raise SettingsError where ``recipe`` cannot be simulated."""
    if sorted(recipe.axes) != sorted(AXES):
        odd = sorted(set(recipe.axes) ^ set(AXES))[0]
        raise SettingsError(f"{where}: axes", f"{odd!r} is missing or not an axis of the crane", f"exactly {', '.join(AXES)}")
    cycles = 1.0 / (recipe.step * recipe.controller.rate)
    if abs(cycles - round(cycles)) > 1e-9 or round(cycles) < 1:
        raise SettingsError(
            f"{where}: step",
            f"{recipe.step} s does not divide the controller's cycle of {1.0 / recipe.controller.rate} s",
            "a whole number of steps in each cycle",
        )
    for name, axis in recipe.axes.items():
        _check_axis(axis, f"{where}: axes.{name}")
    _require(
        0.0 <= recipe.masses.balanced <= 1.0,
        f"{where}: masses.balanced",
        recipe.masses.balanced,
        "a share from 0 to 1 of the weights",
    )
    _require(
        recipe.supply.rated is None or recipe.supply.rated > 0.0,
        f"{where}: supply.rated",
        recipe.supply.rated,
        "more than zero",
    )
    _require(recipe.supply.parked >= 0.0, f"{where}: supply.parked", recipe.supply.parked, "zero or more")
    for name in recipe.build.joint_offset:
        if name not in AXES:
            raise SettingsError(f"{where}: build.joint_offset", f"unknown axis {name!r}", nearest(name, AXES))
    names = [recording.name for recording in recipe.recordings]
    for recording in recipe.recordings:
        place = f"{where}: recording {recording.name!r}"
        if names.count(recording.name) > 1:
            raise SettingsError(place, "name is taken", "a name of its own for every recording")
        if (recording.seconds > 0) == (recording.poses > 0):
            raise SettingsError(place, f"seconds = {recording.seconds}, poses = {recording.poses}", "one of them above zero")
        wrong = check_script(recording)
        if wrong is not None:
            raise SettingsError(place, wrong, "strokes of one axis one after the other, edges up to half of each")
    _check_swaps(recipe, where)
    for key, kinds in (("controller.log", recipe.controller.log), ("capture.export", recipe.capture.export)):
        once = bool(kinds) and len(set(kinds)) == len(kinds)
        _require(once, f"{where}: {key}", list(kinds), "at least one format, each once")


def _require(holds: bool, where: str, found: object, expected: str) -> None:
    """Raise where a setting does not hold."""
    if not holds:
        raise SettingsError(where, f"{found}", expected)


def _check_axis(axis: AxisSettings, where: str) -> None:
    valve = axis.valve
    for key in ("delay", "time_constant", "deadband_positive", "deadband_negative", "silt", "disturbance"):
        _require(getattr(valve, key) >= 0.0, f"{where}.valve.{key}", getattr(valve, key), "zero or more")
    for key in ("gain", "saturation", "direction_ratio", "disturbance_time", "spool_speed"):
        _require(getattr(valve, key) > 0.0, f"{where}.valve.{key}", getattr(valve, key), "more than zero")
    _require(0.0 <= valve.notch <= 1.0, f"{where}.valve.notch", valve.notch, "a share from 0 to 1 of the full opening")
    _require(-1.0 < valve.taper < 1.0, f"{where}.valve.taper", valve.taper, "a share between -1 and 1 of the edge's width")
    _require(axis.backlash >= 0.0, f"{where}.backlash", axis.backlash, "zero or more")
    _require(axis.stiffness > 0.0, f"{where}.stiffness", axis.stiffness, "more than zero")
    _require(0.0 <= axis.flex_damping < 1.0, f"{where}.flex_damping", axis.flex_damping, "a damping ratio from 0 to below 1")
    _check_hydraulics(axis, where)
    for key in ("pitch", "ripple_frequency", "fade_time"):
        _require(getattr(axis.irregular, key) > 0.0, f"{where}.irregular.{key}", getattr(axis.irregular, key), "more than zero")
    low, high = axis.limits
    if not low < axis.park < high:
        raise SettingsError(f"{where}.park", f"{axis.park}", f"a value inside the limits [{low}, {high}]")
    if axis.cylinder is not None:
        _check_cylinder(axis.cylinder, axis.limits, where)


def _check_hydraulics(axis: AxisSettings, where: str) -> None:
    settings = axis.hydraulics
    if settings is None:
        if axis.drive == "hydraulic":
            raise SettingsError(f"{where}.drive", "hydraulic without [hydraulics]", "at least area and area_rod of its pistons")
        return
    positive = ("area", "area_rod", "dead_volume", "spool_frequency", "spool_damping", "stribeck_velocity", "bristle", "relief")
    for key in positive:
        _require(getattr(settings, key) > 0.0, f"{where}.hydraulics.{key}", getattr(settings, key), "more than zero")
    for key in ("flow_force", "hysteresis", "meter_out_lap", "leakage", "spool_leakage", "coulomb", "static", "viscous"):
        _require(getattr(settings, key) >= 0.0, f"{where}.hydraulics.{key}", getattr(settings, key), "zero or more")
    if settings.spool_frequency > 500.0:
        raise SettingsError(f"{where}.hydraulics.spool_frequency", f"{settings.spool_frequency} Hz", "at most 500 Hz")


def _check_cylinder(cylinder: CylinderSettings, limits: tuple[float, float], where: str) -> None:
    shortest, longest = cylinder.retracted, cylinder.retracted + cylinder.stroke
    if not abs(cylinder.a - cylinder.b) < shortest < longest < cylinder.a + cylinder.b:
        raise SettingsError(
            f"{where}.cylinder",
            f"levers {cylinder.a} and {cylinder.b} m cannot hold a cylinder of {shortest:.4f} to {longest:.4f} m",
            f"lengths between {abs(cylinder.a - cylinder.b):.4f} and {cylinder.a + cylinder.b:.4f} m",
        )
    levers = [cylinder.sense * (q + cylinder.offset) for q in limits]
    if min(levers) <= 0.0 or max(levers) >= math.pi:
        raise SettingsError(f"{where}.cylinder.offset", f"lever angles {levers} rad", "angles between 0 and π over the limits")


def _check_swaps(recipe: BenchRecipe, where: object) -> None:
    bodies = {body.name: body for body in recipe.capture.bodies}
    for swap in recipe.capture.swaps:
        recipe.recording(swap.recording)
        if swap.body not in bodies:
            raise SettingsError(f"{where}: swap", f"unknown body {swap.body!r}", nearest(swap.body, bodies))
        count = len(bodies[swap.body].markers)
        if len(set(swap.markers)) != 2 or not all(0 <= index < count for index in swap.markers):
            raise SettingsError(f"{where}: swap", f"markers {list(swap.markers)}", f"two different ones of 0 … {count - 1}")
    for export in recipe.capture.exported_markers:
        recipe.recording(export.recording)
        if export.body not in bodies:
            raise SettingsError(f"{where}: exported_markers", f"unknown body {export.body!r}", nearest(export.body, bodies))
