"""The hydraulic circuit: pump, valves, chambers and the booms they move, in sub-steps of the machine's step.

Per axis, with the chambers A (pushes towards positive motion) and B, speed v of the piston, effective bulk modulus β:

    ṗ_A = β/V_A·(Q_A − A_A·v − Q_leak),   ṗ_B = β/V_B·(Q_B + A_B·v + Q_leak),   F = p_A·A_A − p_B·A_B − friction.

The force acts through the linkage on the rigid bodies. That a load slows an axis, that oil oscillates and that axes share a
pump follows from these equations. Integration is semi-implicit (pressure, then speed, then position), stable while the step is
below 2/ω of the stiffest oil spring. Chamber pressures are limited by vacuum and by the relief valve.

Source: Jelali, Kroll, Hydraulic Servo-systems (2003), ch. 4.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from simulated_bench.compiled import compiled
from simulated_bench.cylinder import Drive, position_of
from simulated_bench.hydraulic_recipe import HydraulicSettings, OilSettings, SupplySettings
from simulated_bench.oil import orifice_flow
from simulated_bench.recipe import AxisSettings
from simulated_bench.rigid_body import RigidBodies, equations, solve3
from simulated_bench.seal import seal_step
from simulated_bench.spool import PLAY_OPERATORS, edges, flow_force, spool_motion, with_hysteresis
from simulated_bench.valve import ValveNumbers, freed, metered

Array = npt.NDArray[np.float64]

#: Sub-step that is stable for the oil springs of a machine of this size [s].
SUB_STEP = 1e-4
#: Columns of the state of one axis, then the play operators of its spool.
SPOOL, SPOOL_SPEED, PRESSURE_A, PRESSURE_B, BRISTLE, FLOW_A, FLOW_B, FRICTION = range(8)
AXIS_STATE = 8 + PLAY_OPERATORS


class Circuit(NamedTuple):
    """Valve and cylinder of one axis as numbers; ``enabled`` 0 = the axis is moved by the simple valve model."""

    enabled: float
    area: float
    area_rod: float
    dead_volume: float
    conductance_positive: float
    conductance_negative: float
    omega: float
    damping: float
    flow_force: float
    hysteresis: float
    meter_out_lap: float
    leakage: float
    spool_leakage: float
    coulomb: float
    static: float
    stribeck: float
    viscous: float
    bristle_stiffness: float
    relief: float


class Supply(NamedTuple):
    """Pump and oil as numbers."""

    pressure: float
    flow_limit: float
    volume: float
    droop: float
    parked: float
    bulk_modulus: float
    transition: float


def circuit_of(axis: AxisSettings, supply: SupplySettings) -> Circuit:
    """Conductances are chosen so that the unloaded axis moves at the valve's ``gain`` per opening."""
    settings = axis.hydraulics
    if axis.drive != "hydraulic" or settings is None:
        return Circuit(*([0.0] * len(Circuit._fields)))
    positive, negative = _conductances(axis.valve.gain, settings, supply.rated or supply.pressure)
    return Circuit(
        1.0,
        settings.area,
        settings.area_rod,
        settings.dead_volume,
        positive,
        negative,
        2.0 * math.pi * settings.spool_frequency,
        settings.spool_damping,
        settings.flow_force,
        settings.hysteresis,
        settings.meter_out_lap,
        settings.leakage,
        settings.spool_leakage,
        settings.coulomb,
        settings.static,
        settings.stribeck_velocity,
        settings.viscous,
        settings.coulomb / settings.bristle,
        settings.relief,
    )


def supply_of(supply: SupplySettings, oil: OilSettings) -> Supply:
    return Supply(
        supply.pressure, supply.flow_limit, supply.volume, supply.droop, supply.parked, oil.bulk_modulus, oil.transition
    )


def _conductances(gain: float, settings: HydraulicSettings, pressure: float) -> tuple[float, float]:
    """From v = K·√(p·A_in/(A_A³ + A_B³)): both edges of a direction in series, no load."""
    cubes = settings.area**3 + settings.area_rod**3
    positive = gain / math.sqrt(pressure * settings.area / cubes)
    if settings.retraction is None:
        return positive, positive
    return positive, settings.retraction / math.sqrt(pressure * settings.area_rod / cubes)


@compiled
def lever(joint: float, position: float, drive: Drive) -> float:
    """Speed of the drive per speed of the joint [m/rad or 1]; ``position`` is that of the drive at ``joint``."""
    if drive.triangle == 0:
        return 1.0
    return drive.sense * drive.a * drive.b * math.sin(drive.sense * (joint + drive.offset)) / (drive.retracted + position)


@compiled
def at_rest(
    joint: Array, circuits: tuple[Circuit, ...], drives: tuple[Drive, ...], bodies: RigidBodies, parked: float
) -> Array:
    """State (axes, AXIS_STATE) in which closed valves hold the booms at ``joint`` (axes,); other chambers: ``parked`` [Pa]."""
    state = np.zeros((len(joint), AXIS_STATE))
    mass = np.empty((3, 3))
    bias = np.empty(3)
    weight = np.empty(3)
    equations(joint, np.zeros(len(joint)), bodies, mass, bias, weight)
    for i in range(len(joint)):
        circuit = circuits[i]
        if circuit.enabled == 0.0:
            continue
        load = 0.0
        if i > 0:
            load = weight[i - 1] / lever(joint[i], position_of(joint[i], drives[i]), drives[i])
        back = parked * min(circuit.area, circuit.area_rod)
        state[i, PRESSURE_A] = (back + max(load, 0.0)) / circuit.area
        state[i, PRESSURE_B] = (back + max(-load, 0.0)) / circuit.area_rod
    return state


@compiled
def advance(
    joint: Array,
    speed: Array,
    prescribed: Array,
    command: Array,
    state: Array,
    line: Array,
    circuits: tuple[Circuit, ...],
    valves: tuple[ValveNumbers, ...],
    drives: tuple[Drive, ...],
    bodies: RigidBodies,
    supply: Supply,
    stops: Array,
    pull: tuple[float, float],
    viscosity: float,
    step: float,
    substeps: int,
) -> None:
    """Advance the hydraulic axes over one step of the machine, in place.

    Args:
        joint, speed: of all axes (4,); those of the simple valve model are not changed.
        prescribed: accelerations of the latter (4,).
        command: delayed command of each axis (4,).
        state: see :func:`at_rest`. line: (1,) pressure of the supply [Pa].
        stops: joint values at the end stops (4, 2).
        pull: horizontal force of the hanging mass on the tip, x and y [N].
    """
    n = len(joint)
    h = step / substeps
    beta = supply.bulk_modulus
    transition = supply.transition * viscosity * viscosity
    mass = np.empty((3, 3))
    bias = np.empty(3)
    weight = np.empty(3)
    right = np.empty(3)
    acceleration = np.empty(3)
    force = np.zeros(n)
    target = np.empty(n)
    for i in range(n):
        target[i] = with_hysteresis(freed(command[i], state[i, SPOOL], valves[i].silt), state[i, 8:], circuits[i].hysteresis)
    for _ in range(substeps):
        drawn = 0.0
        for i in range(n):
            circuit = circuits[i]
            if circuit.enabled == 0.0:
                continue
            drive = drives[i]
            place = position_of(joint[i], drive)
            arm = lever(joint[i], place, drive)
            piston = arm * speed[i]
            row = state[i]
            a, b = row[PRESSURE_A], row[PRESSURE_B]
            inlet, outlet = edges(
                row[SPOOL], valves[i].positive, valves[i].negative, circuit.meter_out_lap, valves[i].saturation
            )
            inlet = metered(inlet, valves[i].notch, valves[i].taper)
            outlet = metered(outlet, valves[i].notch, valves[i].taper)
            if inlet >= 0.0:
                k = circuit.conductance_positive
                # Load check valve: oil does not flow back to the pump.
                into_a = orifice_flow(k * inlet, max(line[0] - a, 0.0), transition)
                into_b = -orifice_flow(k * outlet, b, transition)
                drawn += into_a
                drop = line[0] - a
            else:
                k = circuit.conductance_negative
                into_b = orifice_flow(-k * inlet, max(line[0] - b, 0.0), transition)
                into_a = -orifice_flow(-k * outlet, a, transition)
                drawn += into_b
                drop = line[0] - b
            push = flow_force(inlet, drop, supply.pressure, circuit.flow_force)
            row[SPOOL], row[SPOOL_SPEED] = spool_motion(
                row[SPOOL], row[SPOOL_SPEED], target[i], push, circuit.omega, circuit.damping, valves[i].spool_speed, h
            )
            row[FLOW_A], row[FLOW_B] = into_a, into_b
            across = circuit.leakage / viscosity * (a - b)
            past = circuit.spool_leakage / viscosity
            volume_a = circuit.dead_volume + circuit.area * (place - drive.low)
            volume_b = circuit.dead_volume + circuit.area_rod * (drive.high - place)
            a += h * beta / volume_a * (into_a - circuit.area * piston - across - past * a)
            b += h * beta / volume_b * (into_b + circuit.area_rod * piston + across - past * b)
            # Suction from the tank below vacuum, and the relief valve above its setting.
            row[PRESSURE_A] = min(max(a, 0.0), circuit.relief)
            row[PRESSURE_B] = min(max(b, 0.0), circuit.relief)
            row[BRISTLE], row[FRICTION] = seal_step(
                row[BRISTLE],
                piston,
                circuit.coulomb,
                circuit.static,
                circuit.stribeck,
                circuit.viscous * viscosity,
                circuit.bristle_stiffness,
                h,
            )
            force[i] = (row[PRESSURE_A] * circuit.area - row[PRESSURE_B] * circuit.area_rod - row[FRICTION]) * arm
        if math.isfinite(supply.flow_limit):
            given = min(max(supply.flow_limit * (supply.pressure - line[0]) / supply.droop, 0.0), supply.flow_limit)
            line[0] = min(max(line[0] + h * beta / supply.volume * (given - drawn), 0.0), supply.pressure)
        around, rate = equations(joint, speed, bodies, mass, bias, weight)
        turn = joint[0]
        outward = pull[0] * math.cos(turn) + pull[1] * math.sin(turn)
        aside = pull[1] * math.cos(turn) - pull[0] * math.sin(turn)
        far = bodies.stick_length + joint[3]
        s1, s2 = math.sin(joint[1]), math.sin(joint[1] + joint[2])
        c1, c2 = math.cos(joint[1]), math.cos(joint[1] + joint[2])
        right[0] = force[1] - bias[0] - weight[0] + outward * (-bodies.boom_length * s1 - far * s2)
        right[1] = force[2] - bias[1] - weight[1] - outward * far * s2
        right[2] = force[3] - bias[2] - weight[2] + outward * c2
        for i in range(3):
            if circuits[1 + i].enabled == 0.0:
                mass[i, :] = 0.0
                mass[i, i] = 1.0
                right[i] = prescribed[1 + i]
        solve3(mass, right, acceleration)
        if circuits[0].enabled != 0.0:
            reach = bodies.boom_length * c1 + far * c2
            speed[0] += h * (force[0] + aside * reach - rate * speed[0]) / around
        for i in range(1, n):
            if circuits[i].enabled != 0.0:
                speed[i] += h * acceleration[i - 1]
        for i in range(n):
            if circuits[i].enabled != 0.0:
                joint[i] += h * speed[i]
                if joint[i] < stops[i, 0] or joint[i] > stops[i, 1]:
                    joint[i] = min(max(joint[i], stops[i, 0]), stops[i, 1])
                    speed[i] = 0.0
