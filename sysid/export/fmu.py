"""``fmu``: a co-simulation FMU (FMI 2.0) around the drive model, by PythonFMU."""

from __future__ import annotations

import inspect
import shutil
import weakref
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.effects import Effect
from sysid.export.drive_module import MODULE, write_drive_model
from sysid.export.names import MachineNames, axis_names
from sysid.export.target import Simulation, Start, Support, Target
from sysid.plant import Plant

Array = npt.NDArray[np.float64]
FILE, SLAVE = "Machine.fmu", "fmu_slave.py"


class FmuTarget(Target):
    """FMI 2.0, for co-simulation."""

    name = "fmu"
    title = "FMI 2.0 (co-simulation)"
    modules = ("pythonfmu", "fmpy")
    notes = (
        "The FMU needs a Python with NumPy on the machine that runs it (PythonFMU embeds the interpreter that it finds).",
        "A communication step is a whole number of samples. Outputs are the readings of the sensors.",
    )

    def names(self, plant: Plant) -> MachineNames:
        return axis_names(plant.machine.name, plant.machine.axis_names)

    def otherwise(self, effect: Effect) -> Support:
        return Support("plugin", f"`{MODULE}` inside the FMU")

    def write(self, plant: Plant, rate_hz: float, folder: Path) -> tuple[str, ...]:
        from pythonfmu import FmuBuilder

        names = write_drive_model(plant, rate_hz, folder)
        slave = Path(inspect.getfile(self.__class__)).parent / "standalone" / SLAVE
        # All FMUs of a process share one interpreter: the name of the script is that of its content.
        script = folder / f"machine_{sha256((folder / names[1]).read_bytes()).hexdigest()[:12]}.py"
        script.write_text(slave.read_text("utf-8"), "utf-8")
        FmuBuilder.build_FMU(script, dest=folder, project_files=[folder / name for name in names])
        script.unlink()
        return FILE, *names

    def simulation(self, plant: Plant, folder: Path) -> Simulation | None:
        return FmuSimulation(plant, folder / FILE)


class FmuSimulation:
    """The FMU in FMPy. Its outputs are readings: sensors that are not ideal are undone, for true signals."""

    def __init__(self, plant: Plant, path: Path) -> None:
        import fmpy

        self.plant, self.path = plant, path
        self.description = fmpy.read_model_description(path)
        self.folder = fmpy.extract(path)
        weakref.finalize(self, shutil.rmtree, self.folder, ignore_errors=True)
        self.references = {variable.name: variable.valueReference for variable in self.description.modelVariables}
        self.outputs = [v.name for v in self.description.modelVariables if v.causality == "output"]
        self.slave: Any = None
        self.dt, self.count = 1.0 / plant.machine.rate_hz, 0

    def reset(self, start: Start) -> Mapping[str, float]:
        from fmpy.fmi2 import FMU2Slave

        self.close()
        identifier = self.description.coSimulation.modelIdentifier
        self.slave = FMU2Slave(
            guid=self.description.guid, unzipDirectory=self.folder, modelIdentifier=identifier, instanceName="replay"
        )
        self.slave.instantiate()
        self.slave.setupExperiment(startTime=0.0)
        self.slave.enterInitializationMode()
        for k, name in enumerate(self.plant.machine.axis_names):
            values = {"start_joint": start.joints[k], "start_drive": start.drive[k]}
            values |= {"start_command": start.commands[k], "start_speed": start.speeds[k]}
            for key, value in values.items():
                self.slave.setReal([self.references[f"{name}.{key}"]], [float(value)])
        self.slave.setBoolean([self.references["start_from_drive"]], [True])
        self.slave.exitInitializationMode()
        self.count = 0
        return self._signals()

    def step(self, commands: Array) -> Mapping[str, float]:
        references = [self.references[f"{name}.command"] for name in self.plant.machine.axis_names]
        self.slave.setReal(references, [float(value) for value in commands])
        self.slave.doStep(self.count * self.dt, self.dt)
        self.count += 1
        return self._signals()

    def close(self) -> None:
        """End the running instance."""
        if self.slave is not None:
            self.slave.terminate()
            self.slave.freeInstance()
            self.slave = None

    def _signals(self) -> dict[str, float]:
        values = self.slave.getReal([self.references[name] for name in self.outputs])
        return {name: self._true(name, value) for name, value in zip(self.outputs, values, strict=True)}

    def _true(self, signal: str, reading: float) -> float:
        scale, bias = (self.plant.effect(f"sensor_{key}", signal) for key in ("scale", "bias"))
        shift = 0.0 if bias is None else float(np.asarray(bias.parameters["bias"]))
        return (reading - shift) / (1.0 if scale is None else float(np.asarray(scale.parameters["scale"])))
