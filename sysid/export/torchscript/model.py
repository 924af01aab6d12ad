"""Plant → TorchScript module of its drive chain, with the parameters of its effects by name.

PyTorch deprecates TorchScript, which Isaac Lab loads: its warnings are not those of a user's mistake.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from sysid.effects import effect_named
from sysid.export.drive_data import WITHOUT_PART
from sysid.export.torchscript.equations import Equations
from sysid.plant import Plant
from sysid.plant.layout import slot_indices
from sysid.plant.settled_pose import SETTLING

Array = npt.NDArray[np.float64]
Signals = dict[str, Tensor]

_jit: Any = torch.jit


@contextmanager
def deprecation_known() -> Iterator[None]:
    """Without the warning that TorchScript is deprecated."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"`torch\.jit\..*", DeprecationWarning)
        yield


def save_script(module: Any, path: Path) -> None:
    """Write a script to a file."""
    with deprecation_known():
        _jit.save(module, str(path))


def load_script(path: Path) -> Any:
    """The script of a file, on the CPU."""
    with deprecation_known():
        return _jit.load(str(path), map_location="cpu")


def parameter_columns(plant: Plant) -> dict[str, int]:
    """``effect.target[.side].slot`` → its index in the plant's vector, for all effects that the drive model has."""
    found = {}
    for item in plant.effects:
        effect = effect_named(item.name)
        if effect.name not in WITHOUT_PART:
            place = ".".join(filter(None, (item.name, item.target, item.side)))
            for slot in effect.slots:
                index = slot_indices(plant.machine.axis_names, effect, item.target, item.side, slot.name)[0]
                found[f"{place}.{slot.name}"] = index
    return found


def script_of(plant: Plant, rate_hz: float, thetas: Array | None = None) -> Any:
    """The module, scripted, for steps of 1/``rate_hz``.

    Args:
        thetas: parameter vectors of the plant (count, N) that it must also run with: its longest delays.
    """
    reached = plant.vector()[None] if thetas is None else thetas
    index = parameter_columns(plant)
    longest = {}
    for i, name in enumerate(plant.machine.axis_names):
        if (at := index.get(f"input_delay.{name}.delay")) is not None:
            longest[i] = math.floor(float(reached[:, at].max()) * rate_hz + 1e-9) + 2
    equations = Equations(plant, rate_hz, {at: column for column, at in enumerate(index.values())}, longest)
    soft = [name for name in index if name.startswith("joint_compliance.")] if equations.arrays.posed else []
    settling = (SETTLING if soft else 1) if equations.arrays.posed else 0
    sagging = SETTLING if any(".drive." in name for name in soft) else 0
    values = {name: float(plant.vector()[at]) for name, at in index.items()}
    with deprecation_known():
        functions = equations.script()
        loads = equations.count if equations.arrays.posed else 0
        model = DriveModel(values, functions, loads, settling, sagging, list(equations.signals))
        return _jit.script(model.eval())


class DriveModel(nn.Module):
    """All axes of a machine: commands → drives, joints, end effector and tool, for a batch of N machines.

    Args:
        parameters: names (``effect.target[.side].slot``) and values (P,) of the parameters of one machine.
        functions: those of :class:`sysid.export.torchscript.equations.Equations`.
        blocks: widths of the delayed inputs, which are NaN before the start.
        loads: columns of the state, the first ones, that are the loads of the axes: A, or none without kinematics.
        settling: steps in which a machine at rest settles under the load of its posture; ``sagging``: the same of its drives.
        signals: names of what sensors read.
    """

    def __init__(
        self, parameters: dict[str, float], functions: Any, loads: int, settling: int, sagging: int, signals: list[str]
    ) -> None:  # fmt: skip
        super().__init__()
        self.parameter_names = [*parameters, "none"]
        self.register_buffer("values", torch.tensor([*parameters.values(), 0.0], dtype=torch.float64))
        self.values: Tensor
        self.functions, self.loads, self.settling, self.sagging, self.signals = functions, loads, settling, sagging, signals

    @torch.jit.export
    def theta(self, count: int) -> Tensor:
        """The parameters of ``count`` machines (N, P), all those of the plant; the last column is not used."""
        return self.values[None].repeat(count, 1)

    @torch.jit.export
    def drives(self, theta: Tensor, joints: Tensor) -> Tensor:
        """Positions of the drives (N, A) for joints at their sensors (N, A)."""
        found: Tensor = self.functions.stretch(theta, joints, self.sag(theta, joints))[1]
        return found

    @torch.jit.export
    def begin(
        self, theta: Tensor, joints: Tensor, drives: Tensor, commands: Tensor, speeds: Tensor | None = None
    ) -> tuple[Tensor, Signals]:  # fmt: skip
        """Joints at their sensors, drives, the commands held for a long time before, and speeds of force axes, (N, A) each.

        Without ``speeds`` they are at rest.
        """
        moving = torch.zeros_like(drives) if speeds is None else speeds
        straight = self.functions.stretch(theta, joints, self.sag(theta, joints))[0]
        state = self.functions.start(theta, straight, drives, moving)
        for _ in range(self.settling):
            load = self.functions.place(theta, state)[0][:, : self.loads]
            state = torch.cat([load, state[:, self.loads :]], dim=1)
        state, drive, joint, structure, load, ee, tool = self.functions.place(theta, state)
        state = self.functions.hold(theta, state, commands)
        return state, named(drive, joint, structure, load, ee, tool)

    def forward(self, theta: Tensor, state: Tensor, commands: Tensor) -> tuple[Tensor, Signals]:
        """Hold ``commands`` (N, A) for one sample: the state after it, and the signals.

        Signals: ``drive``, ``joints`` at their sensors, ``structure`` behind them, ``load`` (N, A); ``ee``, ``tool`` (N, 3) in
        the measured frame, NaN without kinematics.
        """
        state, drive, joint, structure, load, ee, tool = self.functions.step(theta, state, commands)
        return state, named(drive, joint, structure, load, ee, tool)

    @torch.jit.export
    def readings(self, theta: Tensor, signals: Signals) -> Signals:
        """Signals as their sensors read them, (N,) each: ``<axis>.cylinder``, ``<axis>.joint``, ``ee.x`` …, ``tool.x`` …."""
        read = self.functions.read(theta, signals["drive"], signals["joints"], signals["ee"], signals["tool"])
        found: dict[str, Tensor] = {}
        for k in range(len(self.signals)):
            found[self.signals[k]] = read[:, k]
        return found

    def sag(self, theta: Tensor, joints: Tensor) -> Tensor:
        """Loads (N, A) under which the drives of joints at their sensors sag."""
        load = torch.zeros_like(joints)
        for _ in range(self.sagging):
            load = self.functions.bend(theta, joints, load)
        return load


def named(drive: Tensor, joints: Tensor, structure: Tensor, load: Tensor, ee: Tensor, tool: Tensor) -> Signals:
    """The signals of a sample."""
    return {"drive": drive, "joints": joints, "structure": structure, "load": load, "ee": ee, "tool": tool}
