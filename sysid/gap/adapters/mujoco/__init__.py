"""A MuJoCo model under test, and its repaired copy, whatever drives its axes.

Effects of force-driven axes and of servos are searched on the plant that needs the same forces or moves alike, and written
into the elements of the model. Other models are run themselves, with effects on their inputs and outputs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from sysid.datasets.recording import Dataset
from sysid.gap.adapters.adapter import SimulatorAdapter
from sysid.gap.adapters.mujoco.force_repair import is_force_driven, open_force_model, write_force_model
from sysid.gap.adapters.mujoco.repair import RepairedModel, open_mujoco, repaired_effects, write_repaired
from sysid.gap.adapters.mujoco.servo_repair import has_servos, open_servo_model, write_servo_model
from sysid.gap.result import GapResult
from sysid.plant import Plant


def open_model(
    path: Path, dataset: Dataset, assets: Sequence[Path] = (), tell: Callable[[str], object] = print
) -> Plant | SimulatorAdapter:
    """What the gap of a model is searched on.

    Args:
        assets: further folders below which the model may open files.
        tell: takes the reason for which a model of servos is run itself.

    Raises:
        InputError: not a file that MuJoCo compiles, or force-driven axes that need other forces than their masses.
        SettingsError: its axes are not those of the dataset.
    """
    if is_force_driven(dataset.machine):
        return open_force_model(path, dataset, assets)
    if has_servos(dataset.machine):
        found = open_servo_model(path, dataset, assets)
        if isinstance(found, Plant):
            return found
        tell(f"note: {path.name} is run itself, which takes longer; effects inside its loops are not searched: {found}")
    return open_mujoco(path, dataset, assets)


def write_model(
    model: Path, tested: Plant | SimulatorAdapter, result: GapResult, out: Path, dataset: Dataset, assets: Sequence[Path] = ()
) -> RepairedModel:
    """Write a copy of ``model`` with the effects of a result, load it again and measure its gap.

    Args:
        tested: that of :func:`open_model`.
        assets: further folders below which the model may open files.

    Raises:
        InputError: the written model does not do what the repaired simulation does.
        SettingsError: ``out`` is the model itself.
    """
    if isinstance(tested, SimulatorAdapter):
        return write_repaired(tested, repaired_effects(tested, result.written), out, dataset, result.gap)
    if has_servos(tested.machine):
        return write_servo_model(model, tested, result, out, dataset, assets)
    return write_force_model(model, tested, result.written, out, dataset, result.stage_gap, assets)
