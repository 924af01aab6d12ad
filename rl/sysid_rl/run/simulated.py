"""A simulated machine: a plant on a simulated clock, with the switches and the time-out of a real one."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError
from sysid.plant import Plant
from sysid.plant.stepper import LaneState, Stepper
from sysid.signals import axis_signal
from sysid_rl.run.clock import SECOND
from sysid_rl.run.transport import MachineInputs, Measurement

Array = npt.NDArray[np.float64]

#: Without a command for this time the machine sets its valves to neutral (ISOBUS).
TIME_OUT_NS = 100_000_000


class SimulatedTransport:
    """The plant as a machine. Its clock starts at zero and advances only in :meth:`wait_until`. It reports what each command
    drives, and the joint of every cylinder.

    Args:
        plant: of velocity (valve) axes.
        joints: initial ones, (A,) [rad or m].
        noise: sensors have the noise of the machine's description.
        seed: of the noise.

    Raises:
        SettingsError: an axis without a valve.
    """

    def __init__(self, plant: Plant, joints: npt.ArrayLike, *, noise: bool = True, seed: int = 0) -> None:
        self._now = 0
        machine = plant.machine
        where = f"simulated {machine.name}"
        for axis in machine.axes:
            if axis.actuation != "velocity":
                raise SettingsError(f"{where}: axis {axis.name}", f"actuation = {axis.actuation!r}", "'velocity' (a valve)")
        driven = {axis.driven: ("drive" if axis.drives == "cylinder" else "joints", i) for i, axis in enumerate(machine.axes)}
        joint_sensors = {
            axis_signal(axis.name, "joint"): ("joints", i) for i, axis in enumerate(machine.axes) if axis.drives == "cylinder"
        }
        #: Signal → field and column of :class:`sysid.plant.stepper.LaneState`.
        self._sources = driven | joint_sensors
        self.signals = tuple(self._sources)
        self._sigma = np.array([machine.noise.get(signal, 0.0) if noise else 0.0 for signal in self.signals])
        self._rng = np.random.default_rng(seed)
        self.axes = machine.axis_names
        self._stepper = Stepper(plant, machine.rate_hz)
        self._period = round(SECOND / machine.rate_hz)
        self._lane = self._stepper.reset(np.asarray(joints, dtype=np.float64))
        self._steps = 0
        self.commands = np.zeros(len(self.axes))
        self._enabled, self._written_ns = False, -TIME_OUT_NS
        self._inputs = MachineInputs(dead_man=False, emergency_stop=False)
        self._readings: dict[str, Measurement] = {}
        self.measure()

    @property
    def truth(self) -> LaneState:
        """The true state of the machine."""
        return self._lane

    @property
    def neutral(self) -> bool:
        """Whether its valves are neutral."""
        late = self._now - self._written_ns >= TIME_OUT_NS
        return late or not self._enabled or self._inputs.emergency_stop or not self._inputs.dead_man

    def open(self) -> None:
        """Nothing to connect."""

    def close(self) -> None:
        """Set the valves to neutral."""
        self._enabled = False

    def read(self) -> tuple[Mapping[str, Measurement], MachineInputs]:
        return dict(self._readings), self._inputs

    def write(self, commands: Array, enabled: bool) -> Array:
        self.commands[:] = np.clip(np.nan_to_num(commands), -1.0, 1.0)
        self._enabled, self._written_ns = enabled, self._now
        return self.commands.copy() if enabled else np.zeros(len(self.axes))

    def set_inputs(self, dead_man: bool | None = None, emergency_stop: bool | None = None) -> None:
        old = self._inputs
        self._inputs = MachineInputs(
            old.dead_man if dead_man is None else dead_man,
            old.emergency_stop if emergency_stop is None else emergency_stop,
        )

    def now_ns(self) -> int:
        return self._now

    def wait_until(self, ns: int) -> None:
        """Simulate the plant until then; each step uses the command at its beginning."""
        while (self._steps + 1) * self._period <= ns:
            self._now = max(self._now, self._steps * self._period)
            self._lane = self._stepper.step(np.zeros(len(self.axes)) if self.neutral else self.commands)
            self._steps += 1
            self._now = self._steps * self._period
            self.measure()
        self._now = max(self._now, ns)

    def measure(self) -> None:
        now = self._steps * self._period
        errors = self._sigma * self._rng.standard_normal(len(self._sigma))
        for (signal, (name, column)), error in zip(self._sources.items(), errors, strict=True):
            value = float(getattr(self._lane, name)[0, column] + error)
            self._readings[signal] = Measurement(value, now, now, self._steps + 1)
