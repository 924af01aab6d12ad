"""The machine: valves, drives, play, linkages, crane and gripper in one loop at the step of the simulation (1 kHz).

An axis is moved by its simple valve model or by the hydraulic circuit (:mod:`sysid.bench.circuit`), which feels the weight and
the motion of all booms. Play and elastic joints come behind either.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.bench.circuit import (
    FRICTION,
    PRESSURE_A,
    PRESSURE_B,
    SUB_STEP,
    Circuit,
    Supply,
    advance,
    at_rest,
    circuit_of,
    supply_of,
)
from sysid.bench.compiled import compiled
from sysid.bench.crane import tip_position
from sysid.bench.cylinder import Drive, against_stops, drive_of, joint_of, position_of
from sysid.bench.drivetrain import follow_with_play
from sysid.bench.elastic_joint import flex_step
from sysid.bench.flight import draw_flight, flight_command
from sysid.bench.gripper import swing
from sysid.bench.irregular import Irregular, flow_share, irregular_of
from sysid.bench.oil import viscosity
from sysid.bench.operator import stroke_command
from sysid.bench.poses import approach_command, draw_targets
from sysid.bench.programs import strokes_of
from sysid.bench.recipe import AXES, Recipe, RecordingSettings
from sysid.bench.rigid_body import Bodies, bodies_of, equations, rod_force
from sysid.bench.valve import Valve, delayed, drive_speed, flow_fluctuation, freed, metered, opening, piloted_step, valve_of

Array = npt.NDArray[np.float64]

#: Longest time the routine needs for one pose: the widest move at the approach speed [s].
LONGEST_MOVE = 30.0


@dataclass(frozen=True)
class Truth:
    """What really happened, free of noise.

    Args:
        time: (n,) [s] since the recording's start.
        command: held command of each axis, (n, 4).
        drive: position of what the valve moves, (n, 4) [m for cylinders and telescope, rad for the slewing drive].
        joint: the structure's joint values, from their stated zeros, after play and sag, (n, 4) [rad, rad, rad, m].
        ee, tool: boom tip and tool point in the base frame, (n, 3) [m].
        still: (start, end) [s] of the phases in which the calibration routine holds a pose, (m, 2); empty by hand.
        pressure: of the chambers A and B of each axis, then of the supply, (n, 9) [Pa]; zeros where nothing is hydraulic.
        friction: seal friction of each axis, (n, 4) [N or N·m].
    """

    time: Array
    command: Array
    drive: Array
    joint: Array
    ee: Array
    tool: Array
    still: Array
    pressure: Array
    friction: Array

    def at(self, times: Array, values: Array) -> Array:
        """Columns of ``values`` (n, m) interpolated at ``times`` (k,), the ends held: (k, m)."""
        return np.stack([np.interp(times, self.time, column) for column in values.T], axis=1)


def run_machine(recipe: Recipe, recording: RecordingSettings, rng: np.random.Generator) -> Truth:
    """Simulate one recording.

    By hand every step is kept; of the calibration routine, which takes an hour, one state per controller cycle.
    """
    axes = [recipe.axis(name) for name in AXES]
    cycle_steps = round(1.0 / (recipe.step * recipe.controller.rate))
    if recording.is_calibration:
        targets = draw_targets(recipe, recording.poses, rng)
        strokes = np.full((len(AXES), 1, 4), np.inf)
        longest = recording.poses * (LONGEST_MOVE + recipe.routine.settle + recipe.routine.hold)
        keep = cycle_steps
    else:
        targets = np.zeros((0, len(AXES)))
        strokes = strokes_of(recipe, recording, rng)
        longest = recording.seconds
        keep = 1
    flies = recording.program == "flight" and not recording.is_calibration
    paths = draw_flight(recipe, recording.seconds, rng) if flies else np.zeros((len(AXES), 0))
    steps = round(longest / recipe.step)
    fluctuations = [flow_fluctuation(axis.valve, steps, recipe.step, rng) for axis in axes]
    width = max(len(values) for values in fluctuations)
    fluctuation = np.stack([np.resize(values, width) for values in fluctuations])
    plays = np.array([axis.backlash for axis in axes])
    kept, states, commands, still = _loop(
        tuple(valve_of(axis.valve) for axis in axes),
        tuple(irregular_of(axis.irregular) for axis in axes),
        tuple(drive_of(axis) for axis in axes),
        plays,
        # Where the drive stands inside its play when the machine is parked is anyone's guess.
        plays * rng.uniform(-0.5, 0.5, len(axes)),
        np.array([axis.park for axis in axes]),
        (recipe.built.height, recipe.built.boom, recipe.built.stick),
        zeros_of(recipe),
        tuple(circuit_of(axis, recipe.supply) for axis in axes),
        bodies_of(recipe.masses, recipe.built.boom, recipe.built.stick, recipe.gripper.length),
        supply_of(recipe.supply, recipe.oil),
        (recipe.oil.start, recipe.oil.end, recipe.oil.warm_up, recipe.oil.reference, recipe.oil.thinning),
        np.array([(axis.stiffness, axis.flex_damping) for axis in axes]),
        (recipe.gripper.length, recipe.gripper.damping_ratio),
        fluctuation,
        strokes,
        paths,
        targets,
        (recipe.operator.margin, recipe.routine.settle, recipe.routine.hold),
        recipe.step,
        steps,
        cycle_steps,
        keep,
    )
    states = states[:kept]
    time = np.arange(kept, dtype=np.float64) * (keep * recipe.step)
    held = np.minimum(np.arange(kept) * keep // cycle_steps, len(commands[0]) - 1)
    parts = (states[:, 0:4], states[:, 4:8], states[:, 8:11], states[:, 11:14])
    return Truth(time, commands.T[held], *parts, still, states[:, 14:23], states[:, 23:27])


def zeros_of(recipe: Recipe) -> Array:
    """True joints less those that the stated zeros give, (4,) [rad, rad, rad, m]."""
    return np.array([recipe.build.joint_offset.get(name, 0.0) for name in AXES])


@compiled
def _loop(
    valves: tuple[Valve, ...],
    irregulars: tuple[Irregular, ...],
    drives: tuple[Drive, ...],
    plays: Array,
    in_play: Array,
    park: Array,
    geometry: tuple[float, float, float],
    zeros: Array,
    circuits: tuple[Circuit, ...],
    bodies: Bodies,
    supply: Supply,
    oil: tuple[float, float, float, float, float],
    flex: Array,
    gripper: tuple[float, float],
    fluctuation: Array,
    strokes: Array,
    paths: Array,
    targets: Array,
    waits: tuple[float, float, float],
    step: float,
    steps: int,
    cycle_steps: int,
    keep: int,
) -> tuple[int, Array, Array, Array]:
    n = len(park)
    margin, settle, hold = waits
    height, boom_length, stick_length = geometry
    length, damping_ratio = gripper
    cycle = cycle_steps * step
    states = np.empty(((steps - 1) // keep + 1, 27))
    commands = np.zeros((n, (steps - 1) // cycle_steps + 1))
    still = np.zeros((len(targets), 2))
    hand = np.zeros((n, 3))
    spool = np.zeros(n)
    held = np.zeros(n)
    position = np.empty(n)
    structure = np.empty(n)
    joint = park.copy()
    there = np.zeros(n)
    for i in range(n):
        structure[i] = position_of(park[i], drives[i])
        position[i] = against_stops(structure[i] + in_play[i], drives[i].low, drives[i].high)
    powered = False
    elastic = False
    for i in range(n):
        powered |= circuits[i].enabled != 0.0
        elastic |= math.isfinite(flex[i, 0])
    substeps = max(round(step / SUB_STEP), 1)
    moved = joint.copy()
    rate = np.zeros(n)
    prescribed = np.zeros(n)
    received = np.zeros(n)
    stops = np.empty((n, 2))
    for i in range(n):
        ends = joint_of(drives[i].low, drives[i]), joint_of(drives[i].high, drives[i])
        stops[i, 0], stops[i, 1] = min(ends), max(ends)
        moved[i] = joint_of(position[i], drives[i])
    hydraulic = at_rest(moved, circuits, drives, bodies, supply.parked)
    line = np.full(1, supply.pressure)
    deflection = np.zeros(n)
    deflecting = np.zeros(n)
    stiff = joint.copy()
    stiff_rate = np.zeros(n)
    mass = np.empty((3, 3))
    bias = np.empty(3)
    weight = np.empty(3)
    if elastic:
        # It was parked long ago: sagged and still.
        for _ in range(50):
            equations(joint + deflection, rate, bodies, mass, bias, weight)
            for i in range(1, n):
                if math.isfinite(flex[i, 0]):
                    deflection[i] = -weight[i - 1] / flex[i, 0]
        joint += deflection
    pivot = np.empty(3)
    next_pivot = np.empty(3)
    tool = np.empty(3)
    velocity = np.zeros(3)
    true = joint + zeros
    pivot[0], pivot[1], pivot[2] = tip_position(true[0], true[1], true[2], true[3], height, boom_length, stick_length)
    tool[:] = pivot
    tool[2] -= length
    pose = 0
    arrived = -1.0
    for k in range(steps):
        time = k * step
        if k % keep == 0:
            row = states[k // keep]
            row[0:4] = position
            row[4:8] = joint
            row[8:11] = pivot
            row[11:14] = tool
            for i in range(n):
                row[14 + 2 * i] = hydraulic[i, PRESSURE_A]
                row[15 + 2 * i] = hydraulic[i, PRESSURE_B]
                row[23 + i] = hydraulic[i, FRICTION]
            row[22] = line[0] if powered else 0.0
        if k % cycle_steps == 0:
            now = k // cycle_steps
            if paths.shape[1] > 0:
                for i in range(n):
                    commands[i, now] = flight_command(
                        position[i],
                        paths[i, now],
                        paths[i, now + 1],
                        cycle,
                        valves[i].gain,
                        valves[i].positive,
                        valves[i].negative,
                    )
            elif len(targets) == 0:
                for i in range(n):
                    commands[i, now] = stroke_command(
                        time, cycle, strokes[i], hand[i], position[i], drives[i].low, drives[i].high, valves[i].gain, margin
                    )
            else:
                moving = False
                for i in range(n):
                    if there[i] == 0.0:
                        overlap = max(valves[i].positive, valves[i].negative)
                        command = approach_command(
                            position[i], targets[pose, i], drives[i].low, drives[i].high, valves[i].gain, overlap
                        )
                        commands[i, now] = command
                        if command == 0.0:
                            there[i] = 1.0
                        else:
                            moving = True
                if not moving and arrived < 0.0:
                    arrived = time
                    still[pose, 0] = time + settle
                    still[pose, 1] = time + settle + hold
                if arrived >= 0.0 and time > still[pose, 1] + cycle:
                    pose += 1
                    arrived = -1.0
                    there[:] = 0.0
                    if pose == len(targets):
                        return k // keep + 1, states, commands, still
        now = k // cycle_steps
        for i in range(n):
            valve = valves[i]
            command = delayed(commands[i, : now + 1], cycle, time, step, valve.delay)
            received[i] = command
            if circuits[i].enabled != 0.0:
                continue
            target = opening(freed(command, spool[i], valve.silt), valve.positive, valve.negative, valve.saturation)
            spool[i], mean = piloted_step(spool[i], target, step, valve.time_constant, valve.spool_speed)
            speed = drive_speed(
                metered(mean, valve.notch), valve.gain, valve.ratio, fluctuation[i, min(k, fluctuation.shape[1] - 1)]
            )
            share, held[i] = flow_share(mean, position[i], time, held[i], irregulars[i], step)
            position[i] = against_stops(position[i] + share * speed * step, drives[i].low, drives[i].high)
            if powered:
                there_now = joint_of(position[i], drives[i])
                prescribed[i] = ((there_now - moved[i]) / step - rate[i]) / step
                rate[i] = (there_now - moved[i]) / step
                moved[i] = there_now
        if powered:
            thick = viscosity(time, oil[0], oil[1], oil[2], oil[3], oil[4])
            pull = rod_force(tool, pivot, bodies.hanging) if length > 0.0 else (0.0, 0.0)
            advance(
                moved,
                rate,
                prescribed,
                received,
                hydraulic,
                line,
                circuits,
                valves,
                drives,
                bodies,
                supply,
                stops,
                pull,
                thick,
                step,
                substeps,
            )
        for i in range(n):
            if circuits[i].enabled != 0.0:
                position[i] = against_stops(position_of(moved[i], drives[i]), drives[i].low, drives[i].high)
            structure[i] = follow_with_play(structure[i], position[i], plays[i])
            joint[i] = joint_of(structure[i], drives[i])
        if elastic:
            _flex(joint, stiff, stiff_rate, deflection, deflecting, bodies, flex, step)
        for i in range(n):
            true[i] = joint[i] + zeros[i]
        next_pivot[0], next_pivot[1], next_pivot[2] = tip_position(
            true[0], true[1], true[2], true[3], height, boom_length, stick_length
        )
        swing(tool, velocity, pivot, next_pivot, length, damping_ratio, step)
        pivot[:] = next_pivot
    return (steps - 1) // keep + 1, states, commands, still


@compiled
def _flex(
    joint: Array,
    stiff: Array,
    stiff_rate: Array,
    deflection: Array,
    deflecting: Array,
    bodies: Bodies,
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
