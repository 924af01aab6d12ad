"""The repaired MJCF of force-driven axes: the model with the identified parameters, and its gap after it is loaded again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from sysid.datasets.recording import Dataset
from sysid.errors import InputError
from sysid.gap import steps
from sysid.gap.adapters.mujoco.force_axes import open_force_model
from sysid.gap.adapters.mujoco.inside import WRITERS, write_inside
from sysid.gap.adapters.mujoco.repair import RepairedModel, check_gap, check_other_file, relocate, write_spec
from sysid.gap.gap_by_stage import stage_gap
from sysid.gap.result import Gap, WrittenEffect
from sysid.machine import KnownEffect
from sysid.machine.sources.mjcf_model import load_mjcf, load_spec
from sysid.plant import Plant


def write_force_model(
    model: Path, tested: Plant, written: Sequence[WrittenEffect], out: Path, dataset: Dataset, promised: Gap
) -> RepairedModel:
    """Write the identified parameters into a copy of ``model``, load it again and measure its force errors.

    Args:
        tested: the plant of the model (:func:`sysid.gap.adapters.mujoco.force_axes.open_force_model`).
        promised: error of the forces at measured motion on held-out recordings, of the repaired plant.

    Raises:
        InputError: MuJoCo refuses the written model, or its error is larger than promised.
        SettingsError: ``out`` is the model itself.
    """
    check_other_file(model, out)
    spec, compiled = load_spec(model), load_mjcf(model)
    kept, dropped = _separable(written)
    native, left = write_inside(spec, compiled, tested.machine, [_known(row) for row in kept], model.name)
    left += [_known(row) for row in dropped]
    relocate(spec, model, out)
    try:
        write_spec(spec, out)
    except ValueError as error:
        raise InputError(out, f"MuJoCo refuses the repaired model ({error})", "masses and inertias of rigid bodies") from None
    study = steps.open_study(dataset, open_force_model(out, dataset).plant)
    measured = stage_gap(study.case, study.stages, study.case.theta).before
    gap = replace(promised, after={signal: measured[signal] for signal in promised.after if signal in measured})
    if not left:
        check_gap(gap, promised, out)
    return RepairedModel(out, None, tuple(native), tuple(left), gap)


def _separable(written: Sequence[WrittenEffect]) -> tuple[list[WrittenEffect], list[WrittenEffect]]:
    """Effects that hold by themselves, and those that do not.

    What is adjusted without a name holds beside the other adjusted parameters only: a constant load beside the first moment of
    a link, for instance. Where MJCF has no place for one of them, none is written.
    """
    adjusted = [row for row in written if row.kind == "adjusted"]
    if all(row.name in WRITERS for row in adjusted):
        return list(written), []
    return [row for row in written if row.kind != "adjusted"], adjusted


def _known(row: WrittenEffect) -> KnownEffect:
    return KnownEffect(row.name, row.target, dict(row.parameters), row.side)  # type: ignore[arg-type]
