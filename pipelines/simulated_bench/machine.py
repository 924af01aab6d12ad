"""The machine: valves, drives, backlash, linkages, crane and gripper in one loop at the step of the simulation (1 kHz).

An axis is moved by its simple valve model or by the hydraulic circuit (:mod:`simulated_bench.circuit`), on which the weight and
the motion of all booms act. Backlash and elastic joints come behind either.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from simulated_bench.circuit import FRICTION, PRESSURE_A, PRESSURE_B
from simulated_bench.compiled import compiled
from simulated_bench.flight import draw_flight, flight_command
from simulated_bench.operator import stroke_command
from simulated_bench.poses import approach_command, draw_targets
from simulated_bench.programs import strokes_of
from simulated_bench.recipe import AXES, BenchRecipe, RecordingSettings
from simulated_bench.stepping import BenchState, MachineNumbers, advance_machine, machine_numbers, parked
from simulated_bench.valve import delayed, flow_fluctuation

Array = npt.NDArray[np.float64]

#: Longest time the routine needs for one pose: the widest move at the approach speed [s].
LONGEST_MOVE = 30.0


@dataclass(frozen=True)
class Truth:
    """True motion, without noise.

    Args:
        time: (n,) [s] since the recording's start.
        command: held command of each axis, (n, 4).
        drive: position of what the valve moves, (n, 4) [m for cylinders and telescope, rad for the slewing drive].
        joint: the structure's joint values, from their stated zeros, after backlash and sag, (n, 4) [rad, rad, rad, m].
        ee, tool: boom tip and tool point in the base frame, (n, 3) [m].
        still: (start, end) [s] of the phases in which the calibration routine holds a pose, (m, 2); else empty.
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


def run_machine(recipe: BenchRecipe, recording: RecordingSettings, rng: np.random.Generator) -> Truth:
    """Simulate one recording.

    Every step is kept; of the calibration routine, which takes an hour, one state per controller cycle.
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
    closed_loop = recording.program == "flight" and not recording.is_calibration
    paths = draw_flight(recipe, recording.seconds, rng) if closed_loop else np.zeros((len(AXES), 0))
    steps = round(longest / recipe.step)
    fluctuations = [flow_fluctuation(axis.valve, steps, recipe.step, rng) for axis in axes]
    width = max(len(values) for values in fluctuations)
    fluctuation = np.stack([np.resize(values, width) for values in fluctuations])
    # The position of a parked drive in its backlash is random.
    numbers = machine_numbers(recipe)
    motion = parked(numbers, np.array([axis.park for axis in axes]), numbers.plays * rng.uniform(-0.5, 0.5, len(axes)))
    kept, states, commands, still = _loop(
        numbers,
        motion,
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


@compiled
def _loop(
    numbers: MachineNumbers,
    motion: BenchState,
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
    valves = numbers.valves
    drives = numbers.drives
    position = motion.position
    n = len(position)
    margin, settle, hold = waits
    cycle = cycle_steps * step
    states = np.empty(((steps - 1) // keep + 1, 27))
    commands = np.zeros((n, (steps - 1) // cycle_steps + 1))
    still = np.zeros((len(targets), 2))
    hand = np.zeros((n, 3))
    there = np.zeros(n)
    disturbance = np.zeros(n)
    pose = 0
    arrived = -1.0
    for k in range(steps):
        time = k * step
        if k % keep == 0:
            row = states[k // keep]
            row[0:4] = position
            row[4:8] = motion.joint
            row[8:11] = motion.pivot
            row[11:14] = motion.tool
            for i in range(n):
                row[14 + 2 * i] = motion.hydraulic[i, PRESSURE_A]
                row[15 + 2 * i] = motion.hydraulic[i, PRESSURE_B]
                row[23 + i] = motion.hydraulic[i, FRICTION]
            row[22] = motion.line[0] if numbers.powered else 0.0
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
            motion.received[i] = delayed(commands[i, : now + 1], cycle, time, step, valves[i].delay)
            disturbance[i] = fluctuation[i, min(k, fluctuation.shape[1] - 1)]
        advance_machine(numbers, motion, disturbance, time, step)
    return (steps - 1) // keep + 1, states, commands, still
