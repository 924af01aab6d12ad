"""``simulink``: a ``.mat`` file with tables and numbers of every axis, and a MATLAB function that steps an axis."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.effects import Effect
from sysid.export.drive_data import drive_data
from sysid.export.lut import LutTarget, numbers_of, simulation_of_tables, tables
from sysid.export.names import MachineNames, Names, axis_names, word
from sysid.export.target import Simulation, Support, Target
from sysid.plant import Plant

Array = npt.NDArray[np.float64]
FILE, FUNCTION = "machine.mat", "step_axis.m"
#: Struct in the file.
NAME = "machine"
#: Longest name of an axis in that of its struct: 63 characters (namelengthmax) less those of ``axis_``.
LONGEST = 58


class SimulinkTarget(Target):
    """MATLAB and Simulink."""

    name = "simulink"
    title = "MATLAB and Simulink"
    notes = (
        "`load machine.mat` gives the struct `machine`: `sample_time`, the names `axes` and one struct for each axis, "
        "`axis_<name>`, with its `name`, `opening` and `speed` "
        "(tables for 1-D Lookup Table blocks, linear extrapolation) and one field for each standard block (Transport Delay, "
        "Rate Limiter, Transfer Fcn, Discrete-Time Integrator with its limits).",
        "`step_axis.m` steps an axis; tests run it in GNU Octave. The replay below interpolates the tables of the file in "
        "Python.",
    )
    native = dict.fromkeys(LutTarget.native, f"`{FILE}`")
    not_representable = LutTarget.not_representable

    def names(self, plant: Plant) -> MachineNames:
        """Letters, digits and underscores, as fields of a struct have them."""
        return axis_names(plant.machine.name, plant.machine.axis_names, Names(form=word, longest=LONGEST))

    def otherwise(self, effect: Effect) -> Support:
        return LutTarget().otherwise(effect)

    def write(self, plant: Plant, rate_hz: float, folder: Path) -> tuple[str, ...]:
        from scipy.io import savemat

        data = drive_data(plant, rate_hz)
        content: dict[str, Any] = {
            "sample_time": 1.0 / rate_hz,
            "plant": plant.reference,
            "axes": np.array(plant.machine.axis_names, dtype=object),
        }
        fields = self.names(plant).axes
        for axis in data["axes"]:
            content[field_name(fields[axis["name"]])] = _fields(axis, 1.0 / rate_hz)
        savemat(folder / FILE, {NAME: content}, oned_as="column", long_field_names=True)
        (folder / FUNCTION).write_text(_FUNCTION, "utf-8")
        return FILE, FUNCTION

    def simulation(self, plant: Plant, folder: Path) -> Simulation | None:
        from scipy.io import loadmat

        stored, names = loadmat(folder / FILE, simplify_cells=True)[NAME], self.names(plant).axes

        def read(axis: str) -> tuple[Array, Array]:
            fields = stored[field_name(names[axis])]
            return np.asarray(fields["opening"], dtype=np.float64), np.asarray(fields["speed"], dtype=np.float64)

        return simulation_of_tables(plant, read)


def field_name(name: str) -> str:
    """The struct of an axis, by its name in the file."""
    return f"axis_{name}"


def _fields(axis: dict[str, Any], dt: float) -> dict[str, Any]:
    fields: dict[str, Any] = {"name": axis["name"], "actuation": axis["actuation"], "drives": axis["drives"]}
    for block, quantity, value in numbers_of(axis):
        fields.setdefault(block, {})[quantity] = _number(value, quantity)
    if axis["actuation"] == "velocity":
        fields["opening"], fields["speed"] = tables(axis, dt)
    if axis["linkage"] is not None:
        link = axis["linkage"]
        fields["linkage"] = np.column_stack([link["low"] + link["step"] * np.arange(len(link["joints"])), link["joints"]])
    return fields


def _number(value: float | None, quantity: str) -> float:
    """A number; an end stop that is not there is infinite."""
    if value is None:
        return -np.inf if quantity == "low" else np.inf
    return float(value)


_FUNCTION = """function [position, state] = step_axis(axis, command, state, dt)
%STEP_AXIS  One sample of an axis of machine.mat.
%   [position, state] = step_axis(machine.axis_boom, command, state, machine.sample_time)
%   command   -1 to 1 of a velocity axis, the position of a position axis [m or rad], the force of a force axis [N or N*m]
%   position  of the drive after the sample [m or rad]; the joint behind a cylinder is
%             interp1(axis.linkage(:,1), axis.linkage(:,2), position, 'linear', 'extrap')
%   state     struct('position', p0) before the first sample: at rest, the command of a velocity axis held since long before.
if strcmp(axis.actuation, 'force')
    if ~isfield(state, 'speed'), state.speed = 0; end
    before = state.speed; state.speed = forced(axis, command, before, dt);
    moved = 0.5 * (before + state.speed) * dt;
    if before ~= 0 && sign(state.speed) ~= sign(before)   % dry friction changes its direction within the sample
        along = sign(before) * (command - axis.load_bias.force);
        stop = axis.inertia.mass * abs(before) / (dry(axis, before) - along);
        state.speed = forced(axis, command, 0, dt - stop);
        moved = 0.5 * (before * stop + state.speed * (dt - stop));
    end
    reached = state.position + moved;
    if reached > axis.end_stop.high, state.speed = min(state.speed, 0); end
    if reached < axis.end_stop.low, state.speed = max(state.speed, 0); end
    state.position = min(max(reached, axis.end_stop.low), axis.end_stop.high);
    position = state.position;
    return
end
u = command;
velocity = strcmp(axis.actuation, 'velocity');
if isfield(axis, 'opening')
    u = interp1(axis.opening(:,1), axis.opening(:,2), u, 'linear', 'extrap');
end
if ~isfield(state, 'held')   % before the first sample
    state.held = u;
    if ~velocity, state.held = state.position; end
end
if ~velocity && isfield(axis, 'command_rate_limit')   % of a servo, at the end of the sample
    reach = axis.command_rate_limit.rate * dt;
    if ~isfield(state, 'ramp'), state.ramp = state.held; end
    state.ramp = state.ramp + min(max(u - state.ramp, -reach), reach); u = state.ramp;
end
if isfield(axis, 'input_delay')
    samples = axis.input_delay.delay / dt; whole = floor(samples); rest = samples - whole;
    if ~isfield(state, 'past'), state.past = repmat(state.held, whole + 2, 1); end
    state.past = [state.past(2:end); u];
    u = (1 - rest) * state.past(end - whole) + rest * state.past(end - whole - 1);
end
if velocity && isfield(axis, 'command_rate_limit')
    reach = axis.command_rate_limit.rate * dt;
    if ~isfield(state, 'ramp'), state.ramp = state.held; end
    before = state.ramp; change = u - before;
    state.ramp = before + min(max(change, -reach), reach);
    if abs(change) > reach, u = before + 0.5 * sign(change) * reach;
    else, u = u - 0.5 * change * abs(change) / reach;
    end
end
if isfield(axis, 'first_order_lag') && axis.first_order_lag.time_constant > 1e-6
    T = axis.first_order_lag.time_constant; decay = exp(-dt / T);
    if ~isfield(state, 'lag'), state.lag = state.held; end
    away = state.lag - u; state.lag = u + away * decay;
    if velocity, u = u + away * (1 - decay) * T / dt; else, u = state.lag; end
end
if isfield(axis, 'second_order_lag')
    T = axis.second_order_lag.time_constant; z = axis.second_order_lag.damping_ratio;
    A = expm([0 1; -1/T^2, -2*z/T] * dt);
    if ~isfield(state, 'second'), state.second = [state.held; 0]; end
    state.second = [u; 0] + A * (state.second - [u; 0]); u = state.second(1);
end
if velocity
    u = interp1(axis.speed(:,1), axis.speed(:,2), u, 'linear', 'extrap');
    if isfield(axis, 'oil_compressibility')
        w = 2 * pi * axis.oil_compressibility.frequency; z = axis.oil_compressibility.damping_ratio;
        A = expm([0 1; -w^2, -2*z*w] * dt);
        if ~isfield(state, 'oil'), state.oil = [u; 0]; end
        x = state.oil - [u; 0]; after = A * x; state.oil = [u; 0] + after;
        u = u - ((after(2) - x(2)) + 2 * z * w * (after(1) - x(1))) / (w^2 * dt);
    end
    u = state.position + dt * u;
end
state.position = min(max(u, axis.end_stop.low), axis.end_stop.high);
position = state.position;
end

function after = forced(axis, force, before, dt)
% Speed after dt under a force and friction, which may stop the motion but not reverse it.
slope = 0;
if isfield(axis, 'viscous_friction')
    slope = axis.viscous_friction.negative;
    if before > 0, slope = axis.viscous_friction.positive; end
end
mobility = dt / axis.inertia.mass; rest = 1 + mobility * slope;
moved = (before + mobility * (force - axis.load_bias.force)) / rest;
after = sign(moved) * max(abs(moved) - mobility * dry(axis, moved) / rest, 0);
end

function force = dry(axis, moved)
% Largest dry friction against a motion of the sign of moved.
force = 0;
if isfield(axis, 'coulomb_friction')
    force = axis.coulomb_friction.positive;
    if moved < 0, force = axis.coulomb_friction.negative; end
end
end
"""
