"""The files that are shipped with an export: the drive model, one Python file that needs NumPy alone and contains the parts of
one plant, its data, and ``effects.csv``, every number of the effects of a plant, for formats that have no place for them.

Shipped Python files are executed from where they were written.
"""

from __future__ import annotations

import csv
import importlib
import inspect
import re
import sys
import uuid
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.effects import Effect, effect_named
from sysid.effects.units import parameter_unit
from sysid.export.drive_data import drive_data
from sysid.export.kernel_source import kernel_name, kernel_source
from sysid.export.standalone import model, parts
from sysid.export.target import Start
from sysid.files import json_text
from sysid.plant import Plant
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]

#: Names of the two files.
MODULE, DATA = "drive_model.py", "drive_model.json"
#: A part that whoever assembles the model adds to its own.
TABLE = "table"
#: Name in the data → class of the parts that are more than the step of one kernel; the others are written by ``_class_of``.
CLASSES: Mapping[str, Any] = {
    "command_rate_limit": parts.CommandRateLimit,
    "first_order_lag": parts.FirstOrderLag,
    "second_order_lag": parts.SecondOrderLag,
    "sticking_spool": parts.StickingSpool,
    "nominal_gain": parts.NominalGain,
}
#: Frame of the model, in the order in which its classes refer to each other.
_FRAME = (
    parts.axis_parameters, parts.Linkage, parts.Backlash, parts.Kinematics, parts.SensorReading, parts.GripperSway,
    model.State, model.Drive, model.ChainDrive, model.VelocityDrive, model.PositionDrive, model.ForceDrive, model.Axis,
    model.DriveModel, model.assemble, model._axis, model._drive,
)  # fmt: skip

#: Names of the machine, its plant and its axes are in the data alone: no text of a file becomes source code.
_HEAD = '''"""Drive model of the machine of {data}: commands → drives, joints, end effector and tool. Needs NumPy alone.

>>> model = load("{data}")
>>> state = model.reset(joints)          # joints at the sensors, (A,) [rad or m]
>>> state = model.step(commands)         # every {dt!r} s; commands (A,) as in machine.toml
>>> model.readings(state)                # signals as the sensors read them

Axes are in the order of ``model.names``. SI units; the base frame of the URDF, gravity along −z.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
#: Standard gravity [m/s²], along −z of the base.
GRAVITY = {gravity}
'''

_TAIL = '''#: Name in the data → class.
PARTS = {{
{parts}
}}


def load(path: str | Path = Path(__file__).with_name("{data}")) -> DriveModel:
    """The model of a data file; by default that beside this file."""
    return assemble(json.loads(Path(path).read_text("utf-8")), PARTS)
'''


def module_text(data: Mapping[str, Any]) -> str:
    """The module for :func:`sysid.export.drive_data.drive_data`, with the parts that these data name."""
    used = used_parts(data)
    own = {name: _class_of(effect_named(name), float(data["dt"])) for name in used if name not in CLASSES}
    names = {name: CLASSES[name].__name__ if name in CLASSES else _class_name(name) for name in used}
    absent = _absent(data)
    written = [parts.Part, *(CLASSES[name] for name in used if name in CLASSES), *(e for e in _FRAME if e not in absent)]
    sources = [inspect.getsource(entry) for entry in dict.fromkeys(written)]
    kernels = [importlib.import_module(f"sysid.effects.{name}").step for name in own]
    kernels += [kernel for module in (parts, model) for kernel in kernels_in("\n".join(sources), module)]
    head = _HEAD.format(data=DATA, dt=float(data["dt"]), gravity=parts.GRAVITY)
    tail = _TAIL.format(parts="\n".join(f'    "{name}": {of},' for name, of in names.items()), data=DATA)
    return "\n\n".join(
        [head, kernel_source(kernels), _constants("\n".join(sources)), sources[0], *own.values(), *sources[1:], tail]
    )


#: Argument of a kernel → what a part passes for it.
_ARGUMENTS = {
    "p": "self.p",
    "i": "0",
    "s": "self.s",
    "j": "0",
    "size": "self.memory",
    "dt": "self.dt",
    "load": "load",
    "gain": "self.gain",
}


def _class_name(effect: str) -> str:
    return effect.title().replace("_", "")


def _class_of(effect: Effect, dt: float) -> str:
    """Source of the part that an effect is whose kernel takes one value a step; one that warms up begins after the hold."""
    kernel = importlib.import_module(f"sysid.effects.{effect.name}").step
    arguments = ["u", *(_ARGUMENTS[name] for name in list(inspect.signature(kernel.py_func).parameters)[1:])]
    step = f"return {kernel_name(kernel)}({', '.join(arguments)})"
    slots = ", ".join(f'"{slot.name}"' for slot in effect.slots)
    lines = [f"class {_class_name(effect.name)}(Part):", f'    """{effect.equation}"""', ""]
    lines += [f"    slots, memory = ({slots},), {effect.memory(dt)}", ""]
    lines += ["    def step(self, u: float, load: float) -> float:", f"        {step}", ""]
    if "time_invariant" in effect.exempt and effect.memory(dt):
        lines += ["    def hold(self, u: float, load: float) -> float:", "        y = self.step(u, load)"]
        lines += ["        self.reset()", "        return y", ""]
    return "\n".join(lines)


def kernels_in(text: str, module: ModuleType) -> list[Any]:
    """Kernels that a text names as the module does."""
    words = set(re.findall(r"\w+", text))
    return [found for name, found in vars(module).items() if name in words and hasattr(found, "py_func")]


def with_classes(module: ModuleType, before: str, classes: Sequence[Any]) -> str:
    """A shipped module without this package: its imports from it become kernels and ``classes``, in front of ``before``."""
    kept = re.sub(r"^from sysid\.\S+ import (\([^)]*\)|.*)\n", "", inspect.getsource(module), flags=re.MULTILINE)
    head, _, rest = kept.replace("import json\n", "import json\nimport math\n", 1).partition(before)
    sources = [inspect.getsource(entry) for entry in classes]
    kernels = [*kernels_in("\n".join(sources), parts), *kernels_in(kept, module)]
    constants = _constants("\n".join([kept, *sources]))
    return "\n\n".join([head.rstrip() + "\n", kernel_source(kernels), constants, *sources, f"{before}{rest}\n"])


def _constants(text: str) -> str:
    """Numbers of the layout that a text names."""
    names = ("PLACES", "NEUTRAL", "REMEMBERED", "SPEED")
    return "\n".join(f"{name} = {getattr(parts, name)!r}" for name in names if name in text)


def _absent(data: Mapping[str, Any]) -> set[Any]:
    """Classes that these data do not need."""
    absent: set[Any] = set()
    if data["sway"] is None:
        absent.add(parts.GripperSway)
    if data["kinematics"] is None:
        absent.add(parts.Kinematics)
    if all(axis["linkage"] is None for axis in data["axes"]):
        absent.add(parts.Linkage)
    if all(axis["actuation"] != "force" for axis in data["axes"]):
        absent.add(model.ForceDrive)
    if model.ForceDrive in absent and "sticking_spool" not in used_parts(data):
        absent.add(parts.axis_parameters)
    return absent


def used_parts(data: Mapping[str, Any]) -> list[str]:
    """Names of the parts of the command stages."""
    return list(dict.fromkeys(name for axis in data["axes"] for name, _ in axis["command"] if name != TABLE))


def module_of(data: Mapping[str, Any]) -> ModuleType:
    """The module for these data, executed."""
    return _executed(module_text(data), Path(MODULE))


def write_drive_model(plant: Plant, rate_hz: float, folder: Path) -> tuple[str, str]:
    """Write the drive model of a plant; returns the names of its two files."""
    data = drive_data(plant, rate_hz)
    (folder / MODULE).write_text(module_text(data), "utf-8")
    (folder / DATA).write_text(json_text(data), "utf-8")
    return MODULE, DATA


def load_module(path: Path) -> Any:
    """A Python file as a module under a name of its own."""
    return _executed(path.read_text("utf-8"), path)


def _executed(text: str, path: Path) -> ModuleType:
    module = ModuleType(f"sysid_export_{path.stem}_{uuid.uuid4().hex[:8]}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module  # dataclasses look their annotations up there
    exec(compile(text, str(path), "exec"), vars(module))
    return module


class ModelSimulation:
    """A model with the methods of the shipped drive model as the simulation of an export; ``signals``: those of its state."""

    def __init__(self, model: Any, signals: Callable[[Any], Mapping[str, float]]) -> None:
        self.model, self.signals = model, signals

    def reset(self, start: Start) -> Mapping[str, float]:
        return self.signals(self.model.reset(start.joints, start.drive, start.commands, start.speeds))

    def step(self, commands: Array) -> Mapping[str, float]:
        return self.signals(self.model.step(commands))


def drive_simulation(plant: Plant, model: Any) -> ModelSimulation:
    """The drive model of a plant alone."""
    return ModelSimulation(model, lambda state: true_signals(plant, state))


def true_signals(plant: Plant, state: Any) -> dict[str, float]:
    """Signals of a state of the drive model, without sensors."""
    found = {}
    for i, axis in enumerate(plant.machine.axes):
        found[axis.driven] = float(state.drive[i])
        if axis.drives == "joint" or axis.name in plant.linkages:
            found[axis_signal(axis.name, "joint")] = float(state.joints[i])
    for point in ("ee", "tool"):
        for k, signal in enumerate(point_signals(point)):
            found[signal] = float(getattr(state, point)[k])
    return {signal: value for signal, value in found.items() if np.isfinite(value)}


EFFECTS = "effects.csv"


def write_effect_table(plant: Plant, folder: Path) -> str:
    """Write the table; returns its name."""
    rows = []
    for item in plant.effects:
        for name, value in item.parameters.items():
            unit = parameter_unit(item.name, name, item.target, plant.machine)
            for k, number in enumerate(np.atleast_1d(np.asarray(value, dtype=np.float64))):
                rows.append((item.name, item.target, item.side or "", name, k, number, unit))
    return write_csv(folder / EFFECTS, ("effect", "target", "side", "parameter", "component", "value", "unit"), rows)


def write_csv(path: Path, header: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    """Write a table, its floats so that they are read as they are; returns its name."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows([[repr(float(v)) if isinstance(v, (float, np.floating)) else v for v in row] for row in rows])
    return path.name
