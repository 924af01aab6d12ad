"""``lut``: lookup tables for a simulator that interpolates: command → opening, opening → speed, cylinder → joint, and numbers.

The simulation of an axis: opening table, dead time, ramp, lag, speed table, oscillation of the oil, integration, linkage table.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.effects import Effect
from sysid.export.drive_data import EDGE, drive_data
from sysid.export.drive_module import TABLE, drive_simulation, module_of, write_csv
from sysid.export.names import MachineNames, Names, axis_names, same_file
from sysid.export.target import Simulation, Support, Target
from sysid.plant import Plant

Array = npt.NDArray[np.float64]
#: Static curves behind the dynamics of a valve; those before them are ``EDGE``.
SPEED = ("gain_error", "asymmetric_gain", "nominal_gain", "internal_leakage")
#: Effects that are numbers of a standard block.
BLOCKS = {
    "input_delay": "transport delay",
    "command_rate_limit": "rate limiter",
    "first_order_lag": "first-order transfer function",
    "second_order_lag": "second-order transfer function",
    "oil_compressibility": "second-order transfer function",
    "viscous_friction": "damping of a force axis",
    "coulomb_friction": "Coulomb friction of a force axis",
    "inertia_error": "inertia of a force axis",
    "load_bias": "constant force of a force axis",
    "force_constant_error": "divides inertia, friction and constant force of a force axis",
}
#: Points on each side of zero.
POINTS = 1000
NUMBERS = "numbers.csv"
#: Longest name of an axis in that of a file [bytes]: file systems hold 255 with what follows it.
LONGEST = 200


class LutTarget(Target):
    """CSV tables and numbers."""

    name = "lut"
    title = "lookup tables (CSV)"
    notes = (
        "Order of a velocity axis: opening table, dead time, ramp, lag, speed table, oscillation of the oil, integration "
        "between the end stops, linkage table. Tables are linear between their points and beyond them.",
    )
    native: Mapping[str, str] = {
        **dict.fromkeys(EDGE, "`<axis>_opening.csv`"),
        **dict.fromkeys(SPEED, "`<axis>_speed.csv`"),
        **{effect: f"`{NUMBERS}`: {block}" for effect, block in BLOCKS.items()},
        "joint_offset": f"`{NUMBERS}`: constant",
    }
    not_representable: Mapping[str, str] = {}

    def names(self, plant: Plant) -> MachineNames:
        """The beginnings of the names of the files of an axis."""
        return axis_names(plant.machine.name, plant.machine.axis_names, Names(fold=same_file, longest=LONGEST))

    def otherwise(self, effect: Effect) -> Support:
        return Support("not_representable", "needs a state or further inputs: neither a table nor a standard block")

    def write(self, plant: Plant, rate_hz: float, folder: Path) -> tuple[str, ...]:
        data, files, numbers = drive_data(plant, rate_hz), [NUMBERS], []
        stems = self.names(plant).axes
        for axis in data["axes"]:
            name, stem, unit = axis["name"], stems[axis["name"]], "m" if axis["drives"] == "cylinder" else "rad or m"
            numbers += [(name, *row) for row in numbers_of(axis)]
            if axis["actuation"] == "velocity":
                opening, speed = tables(axis, 1.0 / rate_hz)
                files += [write_csv(folder / f"{stem}_opening.csv", ("command [1]", "opening [1]"), opening)]
                files += [write_csv(folder / f"{stem}_speed.csv", ("opening [1]", f"speed [{unit} per s]"), speed)]
            if axis["linkage"] is not None:
                link = axis["linkage"]
                places = link["low"] + link["step"] * np.arange(len(link["joints"]))
                header = ("cylinder [m]", "joint [rad or m]")
                files += [write_csv(folder / f"{stem}_linkage.csv", header, zip(places, link["joints"], strict=True))]
        write_csv(folder / NUMBERS, ("axis", "block", "quantity", "value"), numbers)
        return tuple(files)

    def simulation(self, plant: Plant, folder: Path) -> Simulation | None:
        """The written tables between the standard blocks."""
        stems = self.names(plant).axes

        def read(axis: str) -> tuple[Array, Array]:
            return _read(folder / f"{stems[axis]}_opening.csv"), _read(folder / f"{stems[axis]}_speed.csv")

        return simulation_of_tables(plant, read)


def simulation_of_tables(plant: Plant, read: Callable[[str], tuple[Array, Array]]) -> Simulation:
    """Tables of command → opening and opening → speed, (n, 2) each, between the standard blocks.

    Args:
        read: the two tables of a velocity axis.
    """
    data = drive_data(nominal_geometry(plant), plant.machine.rate_hz)
    data |= {"pump_limit": None, "sway": None, "sensors": {}}
    data["axes"] = [_by_tables(axis, read) for axis in data["axes"]]
    module = module_of(data)
    return drive_simulation(plant, module.assemble(data, {**module.PARTS, TABLE: Table}))


def numbers_of(axis: dict[str, Any]) -> list[tuple[str, str, float]]:
    """Block, quantity and value of all numbers of an axis."""
    rows = [("end_stop", end, axis[end]) for end in ("low", "high")] + [("joint_offset", "offset", axis["offset"])]
    blocks = [(part, values) for part, values in axis["command"] if part in BLOCKS]
    rows += [(part, key, value) for part, values in blocks for key, value in values.items() if key not in ("at_end", "lag")]
    if axis["actuation"] == "force":
        rows += [("inertia", "mass", axis["mass"]), ("load_bias", "force", axis["bias"])]
        rows += [(law, key, value) for law, values in axis["frictions"] for key, value in values.items() if law in BLOCKS]
    return rows


def _by_tables(axis: dict[str, Any], read: Callable[[str], tuple[Array, Array]]) -> dict[str, Any]:
    """Drive data of an axis with its written tables in place of the static curves, without what tables do not have."""
    found = axis | dict.fromkeys(("drive_backlash", "structure_backlash", "drive_compliance", "structure_compliance"), 0.0)
    if axis["actuation"] == "velocity":
        opening, speed = read(axis["name"])
        blocks = [part for part in axis["command"] if part[0] in BLOCKS and part[0] != "oil_compressibility"]
        behind = [part for part in axis["command"] if part[0] == "oil_compressibility"]
        found["command"] = [(TABLE, {"points": opening}), *blocks, (TABLE, {"points": speed}), *behind]
    if axis["actuation"] == "force":
        found["frictions"] = [law for law in axis["frictions"] if law[0] in BLOCKS]
        found |= {"rotor": "rigid_drive", "spring": {}}
    return found


class Table:
    """Linear interpolation in points (n, 2), extended along the end slopes."""

    def __init__(self, dt: float, points: Array) -> None:
        self.x, self.y = points.T

    def reset(self) -> None:
        """It has no past."""

    def step(self, u: float, load: float) -> float:
        k = min(max(int(np.searchsorted(self.x, u)) - 1, 0), len(self.x) - 2)
        return float(self.y[k] + (u - self.x[k]) * (self.y[k + 1] - self.y[k]) / (self.x[k + 1] - self.x[k]))

    hold = step


def tables(axis: dict[str, Any], dt: float) -> tuple[Array, Array]:
    """Points (n, 2) of command → opening and opening → speed of a velocity axis."""
    grid = np.linspace(-1.0, 1.0, 2 * POINTS + 1)
    parts = module_of({"axes": [axis], "dt": dt, "sway": None, "kinematics": None}).PARTS
    made = {name: parts[name](dt, **values) for name, values in axis["command"]}
    return _curve(axis, EDGE, made, grid), _curve(axis, SPEED, made, np.array([-1.0, 0.0, 1.0]))


def _curve(axis: dict[str, Any], names: Sequence[str], made: dict[str, Any], grid: Array) -> Array:
    parts = [made[name] for name, _ in axis["command"] if name in names]
    for name, values in axis["command"]:  # corners are points of their own
        if name == "valve_deadband" and "valve_deadband" in names:
            grid = np.union1d(grid, [values["positive"], -values["negative"]])
    out = grid.copy()
    for part in parts:
        out = np.array([part.step(float(x), 0.0) for x in out])
    return np.column_stack([grid, out])


def nominal_geometry(plant: Plant) -> Plant:
    """The plant without the effects between joint and tool, which tables of axes do not contain."""
    kept = tuple(item for item in plant.effects if item.name not in ("link_length_error", "tip_offset", "base_misalignment"))
    return Plant(plant.machine, plant.linkages, kept, plant.streams)


def _read(path: Path) -> Array:
    return np.loadtxt(path, delimiter=",", skiprows=1)
