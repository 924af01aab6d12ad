"""One step of the machine: valves, drives, backlash, linkages, crane and gripper.

:mod:`simulated_bench.machine` steps it through a recording, :mod:`simulated_bench.live` in real time.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from simulated_bench.circuit import SUB_STEP, Circuit, Supply, advance, at_rest, circuit_of, supply_of
from simulated_bench.compiled import compiled
from simulated_bench.crane import tip_position
from simulated_bench.cylinder import Drive, drive_of, joint_of, position_of, within_stops
from simulated_bench.drivetrain import flex_step, follow_with_backlash
from simulated_bench.gripper import swing
from simulated_bench.irregular import Irregular, flow_share, irregular_of
from simulated_bench.oil import viscosity
from simulated_bench.recipe import AXES, BenchRecipe
from simulated_bench.rigid_body import RigidBodies, bodies_of, equations, rod_force
from simulated_bench.valve import ValveNumbers, drive_speed, freed, metered, opening, piloted_step, valve_of

Array = npt.NDArray[np.float64]


class MachineNumbers(NamedTuple):
    """Parameters of the machine for compiled code.

    Args:
        plays: full widths (4,). geometry: height, boom and stick [m]. zeros: true joints less those of the stated zeros (4,).
        oil: start, end, warm-up, reference and thinning. flex: stiffness and damping ratio of each joint, (4, 2).
        gripper: length [m] and damping ratio. stops: joint values at the end stops (4, 2).
        powered: any axis has a hydraulic circuit. elastic: any joint is elastic.
    """

    valves: tuple[ValveNumbers, ...]
    irregulars: tuple[Irregular, ...]
    drives: tuple[Drive, ...]
    plays: Array
    geometry: tuple[float, float, float]
    zeros: Array
    circuits: tuple[Circuit, ...]
    bodies: RigidBodies
    supply: Supply
    oil: tuple[float, float, float, float, float]
    flex: Array
    gripper: tuple[float, float]
    stops: Array
    powered: bool
    elastic: bool


class BenchState(NamedTuple):
    """State of the machine; every entry is changed in place.

    Args:
        position: of the drives (4,). structure: behind the backlash (4,). joint: of the structure, from the stated zeros (4,).
        received: command at each valve, after its delay (4,). spool, held: of the simple valves (4,).
        moved, rate, prescribed: joints before the backlash, their rates and prescribed accelerations (4,).
        hydraulic: see :func:`simulated_bench.circuit.at_rest`. line: pressure of the supply (1,).
        deflection, deflecting, stiff, stiff_rate: of the elastic joints (4,).
        pivot, tool, velocity: boom tip, tool point and its velocity in the base frame (3,).
    """

    position: Array
    structure: Array
    joint: Array
    received: Array
    spool: Array
    held: Array
    moved: Array
    rate: Array
    prescribed: Array
    hydraulic: Array
    line: Array
    deflection: Array
    deflecting: Array
    stiff: Array
    stiff_rate: Array
    pivot: Array
    tool: Array
    velocity: Array


def zeros_of(recipe: BenchRecipe) -> Array:
    """True joints less those that the stated zeros give, (4,) [rad, rad, rad, m]."""
    return np.array([recipe.build.joint_offset.get(name, 0.0) for name in AXES])


def machine_numbers(recipe: BenchRecipe) -> MachineNumbers:
    """The machine of ``recipe``."""
    axes = [recipe.axis(name) for name in AXES]
    drives = tuple(drive_of(axis) for axis in axes)
    circuits = tuple(circuit_of(axis, recipe.supply) for axis in axes)
    ends = [sorted((joint_of(drive.low, drive), joint_of(drive.high, drive))) for drive in drives]
    flex = np.array([(axis.stiffness, axis.flex_damping) for axis in axes])
    return MachineNumbers(
        tuple(valve_of(axis.valve) for axis in axes),
        tuple(irregular_of(axis.irregular) for axis in axes),
        drives,
        np.array([axis.backlash for axis in axes]),
        (recipe.built_geometry.height, recipe.built_geometry.boom, recipe.built_geometry.stick),
        zeros_of(recipe),
        circuits,
        bodies_of(recipe.masses, recipe.built_geometry.boom, recipe.built_geometry.stick, recipe.gripper.length),
        supply_of(recipe.supply, recipe.oil),
        (recipe.oil.start, recipe.oil.end, recipe.oil.warm_up, recipe.oil.reference, recipe.oil.thinning),
        flex,
        (recipe.gripper.length, recipe.gripper.damping_ratio),
        np.array(ends),
        any(circuit.enabled != 0.0 for circuit in circuits),
        bool(np.isfinite(flex[:, 0]).any()),
    )


@compiled
def parked(numbers: MachineNumbers, park: Array, backlash_offset: Array) -> BenchState:
    """The machine at rest with its joints at ``park`` (4,), its drives at ``backlash_offset`` (4,) in their backlash."""
    n = len(park)
    drives = numbers.drives
    position = np.empty(n)
    structure = np.empty(n)
    joint = park.copy()
    moved = joint.copy()
    for i in range(n):
        structure[i] = position_of(park[i], drives[i])
        position[i] = within_stops(structure[i] + backlash_offset[i], drives[i].low, drives[i].high)
        moved[i] = joint_of(position[i], drives[i])
    hydraulic = at_rest(moved, numbers.circuits, drives, numbers.bodies, numbers.supply.parked)
    line = np.full(1, numbers.supply.pressure)
    deflection = np.zeros(n)
    stiff = joint.copy()
    if numbers.elastic:
        mass = np.empty((3, 3))
        bias = np.empty(3)
        weight = np.empty(3)
        # At rest with its sag.
        for _ in range(50):
            equations(joint + deflection, np.zeros(n), numbers.bodies, mass, bias, weight)
            for i in range(1, n):
                if math.isfinite(numbers.flex[i, 0]):
                    deflection[i] = -weight[i - 1] / numbers.flex[i, 0]
        joint += deflection
    height, boom_length, stick_length = numbers.geometry
    true = joint + numbers.zeros
    pivot = np.empty(3)
    pivot[0], pivot[1], pivot[2] = tip_position(true[0], true[1], true[2], true[3], height, boom_length, stick_length)
    tool = pivot.copy()
    tool[2] -= numbers.gripper[0]
    return BenchState(
        position,
        structure,
        joint,
        np.zeros(n),
        np.zeros(n),
        np.zeros(n),
        moved,
        np.zeros(n),
        np.zeros(n),
        hydraulic,
        line,
        deflection,
        np.zeros(n),
        stiff,
        np.zeros(n),
        pivot,
        tool,
        np.zeros(3),
    )


@compiled
def advance_machine(numbers: MachineNumbers, motion: BenchState, fluctuation: Array, time: float, step: float) -> None:
    """Advance ``motion`` by ``step`` [s] under ``motion.received``.

    Args:
        fluctuation: relative flow disturbance of each axis in this step (4,).
        time: since the start [s]; oil and irregularities go by it.
    """
    valves = numbers.valves
    drives = numbers.drives
    circuits = numbers.circuits
    position = motion.position
    joint = motion.joint
    spool = motion.spool
    moved = motion.moved
    rate = motion.rate
    n = len(position)
    length, damping_ratio = numbers.gripper
    for i in range(n):
        valve = valves[i]
        if circuits[i].enabled != 0.0:
            continue
        target = opening(freed(motion.received[i], spool[i], valve.silt), valve.positive, valve.negative, valve.saturation)
        spool[i], mean = piloted_step(spool[i], target, step, valve.time_constant, valve.spool_speed)
        speed = drive_speed(metered(mean, valve.notch, valve.taper), valve.gain, valve.ratio, fluctuation[i])
        share, motion.held[i] = flow_share(mean, position[i], time, motion.held[i], numbers.irregulars[i], step)
        position[i] = within_stops(position[i] + share * speed * step, drives[i].low, drives[i].high)
        if numbers.powered:
            there_now = joint_of(position[i], drives[i])
            motion.prescribed[i] = ((there_now - moved[i]) / step - rate[i]) / step
            rate[i] = (there_now - moved[i]) / step
            moved[i] = there_now
    if numbers.powered:
        oil = numbers.oil
        thick = viscosity(time, oil[0], oil[1], oil[2], oil[3], oil[4])
        pull = rod_force(motion.tool, motion.pivot, numbers.bodies.hanging) if length > 0.0 else (0.0, 0.0)
        advance(
            moved,
            rate,
            motion.prescribed,
            motion.received,
            motion.hydraulic,
            motion.line,
            circuits,
            valves,
            drives,
            numbers.bodies,
            numbers.supply,
            numbers.stops,
            pull,
            thick,
            step,
            max(round(step / SUB_STEP), 1),
        )
    for i in range(n):
        if circuits[i].enabled != 0.0:
            position[i] = within_stops(position_of(moved[i], drives[i]), drives[i].low, drives[i].high)
        motion.structure[i] = follow_with_backlash(motion.structure[i], position[i], numbers.plays[i])
        joint[i] = joint_of(motion.structure[i], drives[i])
    if numbers.elastic:
        _flex(joint, motion.stiff, motion.stiff_rate, motion.deflection, motion.deflecting, numbers.bodies, numbers.flex, step)
    true = joint + numbers.zeros
    height, boom_length, stick_length = numbers.geometry
    pivot = np.empty(3)
    pivot[0], pivot[1], pivot[2] = tip_position(true[0], true[1], true[2], true[3], height, boom_length, stick_length)
    swing(motion.tool, motion.velocity, motion.pivot, pivot, length, damping_ratio, step)
    motion.pivot[:] = pivot


@compiled
def _flex(
    joint: Array,
    stiff: Array,
    stiff_rate: Array,
    deflection: Array,
    deflecting: Array,
    bodies: RigidBodies,
    flex: Array,
    step: float,
) -> None:
    """Add the elastic deflection to ``joint`` (4,); ``stiff`` and its rate are where a rigid structure was a step ago."""
    mass = np.empty((3, 3))
    bias = np.empty(3)
    weight = np.empty(3)
    around, _ = equations(joint + deflection, np.zeros(len(joint)), bodies, mass, bias, weight)
    for i in range(len(joint)):
        now = (joint[i] - stiff[i]) / step
        jump = now - stiff_rate[i]
        stiff[i] = joint[i]
        stiff_rate[i] = now
        if math.isfinite(flex[i, 0]):
            moment = weight[i - 1] if i > 0 else 0.0
            inertia = mass[i - 1, i - 1] if i > 0 else around
            deflection[i], deflecting[i] = flex_step(
                deflection[i], deflecting[i], jump, moment, inertia, flex[i, 0], flex[i, 1], step
            )
            joint[i] += deflection[i]
