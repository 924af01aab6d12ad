"""The detection limit: the magnitude at which an effect adds as much to the residual of its stage as is there without it.

The residual without it consists of sensor noise, flow disturbance, and the model error of the owner's plant. Both parts are
measured on runs without sensor noise; the noise is added by its standard deviation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.optimize import brentq
from scipy.signal import sosfiltfilt

from agreement.machines import parsed
from hidden.kinds import Kind
from hidden.machines import Tables
from simulated_bench.crane import tip_position
from simulated_bench.cylinder import drive_of, joint_of
from simulated_bench.joint_machines import description_of
from simulated_bench.joint_recipe import ServoArm, Slide
from simulated_bench.machine import Truth, run_machine
from simulated_bench.nominal import CommandChain, loads, predict
from simulated_bench.recipe import AXES, BenchRecipe, RecordingSettings
from simulated_bench.sensors import through
from simulated_bench.servo_arm import run_servo_arm
from simulated_bench.slide import run_slide
from sysid.datasets import Recording
from sysid.machine import machine_from_files
from sysid.plant.force import force_inputs

Array = npt.NDArray[np.float64]

#: Noise of a stage of the crane per noise of a marker coordinate, of the joints [rad/m] and of points as distances [1].
#: They follow from how far the markers of a body are apart, and from the lengths of the booms behind them.
PER_MARKER = {"slew": 3.7, "boom": 6.4, "stick": 6.3, "ee": 6.8, "tool": 1.8}
#: Stride of the evaluated rows of a run.
EVERY = 10
#: Number of recordings: the first ones contain every relevant program.
SEEN = 3
#: Tolerance of the search (logarithm of the magnitude).
CLOSE = 0.02


@dataclass(frozen=True)
class Limit:
    """Detection limit: the ``magnitude``, and the residual without the effect [unit of the stage or noise floors]."""

    magnitude: float
    without: float


def limit_of(kind: Kind, direction: int, visible: Tables, error: Callable[[Tables], tuple[float, float]]) -> Limit:
    """The detection limit of ``kind`` on a machine.

    Args:
        error: hidden machine's tables → (residual without sensor noise, noise) of the kind's stage.
    """
    base, noise = error(visible)
    wanted = base**2 + noise**2

    def excess(logarithm: float) -> float:
        """Logarithm of the ratio of added to present residual; a straight line for a proportional effect."""
        changed = kind.change(visible, float(np.exp(logarithm)), direction)
        added = error(overlaid_lists(visible, changed))[0] ** 2 - base**2
        return float(np.log(max(added, 1e-12 * wanted) / wanted))

    low, high = np.log(1e-4 * kind.most), np.log(kind.most)
    without = float(np.sqrt(wanted))
    if excess(high) < 0.0:
        return Limit(float("inf"), without)
    if excess(low) > 0.0:
        return Limit(float(np.exp(low)), without)
    return Limit(float(np.exp(brentq(excess, low, high, xtol=CLOSE))), without)


def overlaid_lists(below: Tables, above: Tables) -> Tables:
    """Tables of ``above`` over those of ``below``; numbers as keys change entries of a list, sensors are joined by signal."""
    merged = dict(below)
    for key, value in above.items():
        under = merged.get(key)
        if isinstance(value, dict) and isinstance(under, list):
            merged[key] = [{**entry, **value.get(k, {})} for k, entry in enumerate(under)]
        elif isinstance(value, dict) and isinstance(under, dict):
            merged[key] = overlaid_lists(under, value)
        elif key == "sensors" and isinstance(under, list):
            by_signal = ({entry["signal"]: entry for entry in entries} for entries in (under, value))
            merged[key] = list(overlaid_lists(*by_signal).values())
        else:
            merged[key] = value
    return merged


def error_of(kind: Kind, visible: Tables, nominal: CommandChain | None) -> Callable[[Tables], tuple[float, float]]:
    """What :func:`limit_of` needs for a machine's family."""
    owner = parsed(visible, "visible")
    if isinstance(owner, ServoArm):
        return lambda tables: _arm_error(kind, owner, tables)
    if isinstance(owner, Slide):
        return _slide_error(owner)
    assert nominal is not None
    return lambda tables: _crane_error(kind, owner, nominal, tables)


# ---- Joint machines -----------------------------------------------------------------------------------------------------


def _arm_error(kind: Kind, owner: ServoArm, tables: Tables) -> tuple[float, float]:
    real = parsed(tables, "hidden")
    assert isinstance(real, ServoArm)
    place = [axis.name for axis in owner.axes].index(kind.target)
    left = [run_servo_arm(real, t)[2][:, place] - run_servo_arm(owner, t)[2][:, place] for t in owner.recordings]
    return _rms(left), owner.noise


def _slide_error(owner: Slide) -> Callable[[Tables], tuple[float, float]]:
    """Residual of the owner's formula for the force at measured motion, filtered as in the workflow."""
    axis = machine_from_files(description_of(owner), "slide").axis("carriage")

    def left(slide: Slide, noisy: bool) -> Array:
        parts = []
        for take in owner.recordings[:SEEN]:
            time, force, position = run_slide(slide, take)
            draw = np.random.default_rng([take.seed, 77])
            if noisy:
                force = force + owner.force_noise * draw.standard_normal(len(force))
                position = position + owner.noise * draw.standard_normal(len(position))
            table = pd.DataFrame({"time": time, "carriage.command": force, "carriage.joint": position})
            seen = force_inputs(Recording("take", table, owner.rate), axis)
            friction = owner.viscous * seen.speed + owner.coulomb * np.sign(seen.speed)
            expected = sosfiltfilt(seen.low_pass, owner.mass * seen.acceleration + friction)[seen.rows]
            parts.append(seen.force - expected)
        return np.concatenate(parts)

    squares = [float(np.mean(left(owner, noisy) ** 2)) for noisy in (True, False)]
    noise = max(squares[0] - squares[1], 0.0) ** 0.5

    def error(tables: Tables) -> tuple[float, float]:
        slide = parsed(tables, "hidden")
        assert isinstance(slide, Slide)
        return _rms([left(slide, False)]), noise

    return error


# ---- Cranes -------------------------------------------------------------------------------------------------------------


def _crane_error(kind: Kind, owner: BenchRecipe, nominal: CommandChain, tables: Tables) -> tuple[float, float]:
    real = parsed(tables, "hidden")
    assert isinstance(real, BenchRecipe)
    left = [stage_residual(kind, owner, nominal, real, _run(real, each)) for each in owner.recordings[:SEEN]]
    return _rms(left), stage_noise(kind, owner)


def _run(recipe: BenchRecipe, recording: RecordingSettings) -> Truth:
    return run_machine(recipe, recording, np.random.default_rng([recipe.seed, recording.seed, 0]))


def stage_noise(kind: Kind, owner: BenchRecipe) -> float:
    """Standard deviation of the sensor noise in the residual of a stage, [unit] or, of several axes, 1."""
    wire = float(np.hypot(owner.draw_wire.noise, owner.draw_wire.quantum / 12.0**0.5))
    if kind.stage == "command":
        if kind.target == "machine":
            return 1.0
        axis = kind.target.partition(".")[0]
        return PER_MARKER["slew"] * owner.capture.noise if axis == "slew" else wire
    place = kind.target.partition(".")[0]
    return PER_MARKER[place] * owner.capture.noise


def stage_residual(kind: Kind, owner: BenchRecipe, nominal: CommandChain, real: BenchRecipe, truth: Truth) -> Array:
    """Measured less predicted output of a stage, driven by its measured input, without noise."""
    rows = slice(None, None, EVERY)
    if kind.stage == "command":
        axes = AXES if kind.target == "machine" else (kind.target.partition(".")[0],)
        columns = [AXES.index(axis) for axis in axes]
        seen = np.stack([_seen(real, truth, axis) for axis in axes], axis=1)
        left = seen[rows] - predict(owner, nominal, truth, loads(owner, truth), columns)[rows]
        # Free runs start from what the sensors show.
        left = left - np.median(left[:20], axis=0)
        if kind.target == "machine":
            wire = float(np.hypot(owner.draw_wire.noise, owner.draw_wire.quantum / 12.0**0.5))
            left = left / np.array([PER_MARKER["slew"] * owner.capture.noise if a == "slew" else wire for a in axes])
        return np.asarray(left.ravel())
    if kind.stage == "joint":
        axis = kind.target.partition(".")[0]
        i, drive = AXES.index(axis), drive_of(owner.axis(axis))
        through_linkage = np.array([joint_of(float(c), drive) for c in _seen(real, truth, axis)[rows]])
        return np.asarray(truth.joint[rows, i] - through_linkage)
    if kind.stage == "end_effector":
        joints = np.column_stack([truth.joint[rows, :3], _seen(real, truth, "telescope")[rows]])
        built = owner.geometry
        drawn = np.array([tip_position(q[0], q[1], q[2], q[3], built.height, built.boom, built.stick) for q in joints])
        moved = truth.ee[rows] + np.cross(np.array(real.capture.tilt), truth.ee[rows]) + np.array(real.capture.shift)
        return np.asarray(np.linalg.norm(moved - drawn, axis=1))
    return np.asarray(np.linalg.norm(truth.tool[rows] - truth.ee[rows], axis=1))


def _seen(real: BenchRecipe, truth: Truth, axis: str) -> Array:
    """What the sensor of a drive shows, without noise: its wire, or the camera's view of the column."""
    if axis == "slew":
        return np.asarray(truth.joint[:, 0])
    return through(truth.drive[:, AXES.index(axis)], real.sensor(real.drive_signal(axis)))


def _rms(parts: Sequence[Array]) -> float:
    joined = np.concatenate([np.ravel(part) for part in parts])
    return float(np.sqrt(np.mean(joined**2)))
