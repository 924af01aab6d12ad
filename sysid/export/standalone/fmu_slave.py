"""An exported machine as a co-simulation FMU (FMI 2.0): commands in, sensor readings out, in samples of the machine.

A communication step is a whole number of samples, during which the commands are held. Parameters set the state from which
it begins: ``<axis>.start_joint`` at the sensor, or ``<axis>.start_drive`` of the drive where ``start_from_drive`` is set,
``<axis>.start_command``, held since long before, and ``<axis>.start_speed`` of a force axis.
"""

from __future__ import annotations

import importlib.util
import re
import sys
from copy import deepcopy
from pathlib import Path
from typing import Any

from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class Machine(Fmi2Slave):  # type: ignore[misc, unused-ignore]
    """The drive model behind FMI."""

    author = "sysid"
    description = "drive model of a machine"

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.machine = _module(Path(self.resources) / "drive_model.py").load()
        count = len(self.machine.names)
        self.commands, self.start_from_drive = [0.0] * count, False
        self.start: dict[str, list[float]] = {key: [0.0] * count for key in ("joint", "drive", "command", "speed")}
        self.outputs = self._begin()
        self.done = 0
        for k, name in enumerate(self.machine.names):
            self._variable(f"{name}.command", self.commands, k, Fmi2Causality.input, Fmi2Variability.discrete)
            for key, values in self.start.items():
                self._variable(f"{name}.start_{key}", values, k, Fmi2Causality.parameter, Fmi2Variability.fixed)
        self.register_variable(
            Boolean("start_from_drive", causality=Fmi2Causality.parameter, variability=Fmi2Variability.fixed)
        )
        for name in self.outputs:
            output = Real(
                name, causality=Fmi2Causality.output, variability=Fmi2Variability.discrete,
                getter=lambda name=name: self.outputs[name],
            )  # fmt: skip
            self.register_variable(output)

    def _variable(self, name: str, values: list[float], k: int, causality: Any, variability: Any) -> None:
        def read() -> float:
            return values[k]

        def write(value: float) -> None:
            values[k] = value

        self.register_variable(Real(name, causality=causality, variability=variability, start=0.0, getter=read, setter=write))

    def to_xml(self, *args: Any) -> Any:
        """The description, with what PythonFMU leaves out: the outputs are unknown at the start, as all of them are calculated.

        Names of axes that are no identifiers of FMI (``a-b``, ``größe``, ``1``) are those of the ``flat`` convention.
        """
        root = super().to_xml(*args)
        structure = root.find("ModelStructure")
        structure.append(deepcopy(structure.find("Outputs")))
        structure[-1].tag = "InitialUnknowns"
        if any(re.fullmatch("[A-Za-z_][A-Za-z0-9_]*", name) is None for name in self.machine.names):
            root.set("variableNamingConvention", "flat")
        return root

    def exit_initialization_mode(self) -> None:
        self.outputs, self.done = self._begin(), 0

    def do_step(self, current_time: float, step_size: float) -> bool:
        samples = round((current_time + step_size) / self.machine.dt) - self.done
        for _ in range(samples):
            self.outputs = self.machine.readings(self.machine.step(self.commands))
        self.done += samples
        return True

    def _begin(self) -> dict[str, float]:
        drive = self.start["drive"] if self.start_from_drive else None
        state = self.machine.reset(self.start["joint"], drive, self.start["command"], self.start["speed"])
        found: dict[str, float] = self.machine.readings(state)
        return found


def _module(path: Path) -> Any:
    """The drive model of this FMU: all FMUs of a process share one interpreter, so that its name is that of its folder."""
    name = f"drive_model_{abs(hash(str(path)))}"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None
        assert spec.loader is not None
        sys.modules[name] = module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    return sys.modules[name]
