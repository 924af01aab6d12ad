"""Sensors on the machine's computer: draw wires and the inductive slewing sensor."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from simulated_bench.recipe import AXES, WIRED, BenchRecipe, SensorSettings, SlewSensorSettings, WireSettings

Array = npt.NDArray[np.float64]


def converted(values: Array, quantum: float) -> Array:
    """``values`` in whole quanta; 0 = not quantised."""
    return np.round(values / quantum) * quantum if quantum > 0.0 else values


def through(values: Array, sensor: SensorSettings | None) -> Array:
    """Readings of a sensor with its errors, from ideal readings."""
    if sensor is None:
        return values
    if sensor.aside != 0.0:
        values = np.hypot(sensor.standoff + values, sensor.aside) - np.hypot(sensor.standoff, sensor.aside)
    return converted(sensor.scale * values + sensor.bias, sensor.quantum)


def read_machine(recipe: BenchRecipe, drive: Array, joint: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Readings of the draw wires (…, 3) [m] and of the slewing sensor (…) [rad] at true drives and joints (…, 4)."""
    wires = read_wires(drive[..., [AXES.index(name) for name in WIRED]], recipe.draw_wire, rng)
    slew = read_slew((drive if recipe.slew_sensor.mount == "drive" else joint)[..., 0], recipe.slew_sensor, rng)
    sensors = [recipe.sensor(recipe.drive_signal(name)) for name in WIRED]
    wires = np.stack([through(wires[..., k], sensor) for k, sensor in enumerate(sensors)], axis=-1)
    return wires, through(slew, recipe.sensor("slew.joint"))


def read_wires(lengths: Array, settings: WireSettings, rng: np.random.Generator) -> Array:
    """Draw wire readings of true ``lengths`` (any shape) [m]."""
    return converted(lengths + settings.noise * rng.standard_normal(lengths.shape), settings.quantum)


def slew_error(angle: Array, largest: float) -> Array:
    """Systematic error of the slewing sensor [rad], smooth and periodic over a turn, never above ``largest``.

    The shape is that of an eccentric ring (once per turn) that is slightly oval (twice per turn).
    """
    return largest * (0.62 * np.sin(angle + 0.7) + 0.38 * np.sin(2.0 * angle - 1.1))


def read_slew(angle: Array, settings: SlewSensorSettings, rng: np.random.Generator) -> Array:
    """Readings of the slewing sensor at true angles of the structure (n,) [rad]."""
    seen = angle + slew_error(angle, settings.error) + settings.noise * rng.standard_normal(angle.shape)
    return converted(seen, settings.quantum)
