"""The repaired MJCF of force-driven axes: the model with the identified parameters, and its gap after it is loaded again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from sysid.datasets.recording import Dataset
from sysid.errors import InputError
from sysid.gap import steps
from sysid.gap.adapters.mujoco.force_axes import open_force_model
from sysid.gap.adapters.mujoco.inertials import ADJUSTED, TOGETHER, in_command_units, write_inertials
from sysid.gap.adapters.mujoco.inside import WRITERS, write_inside
from sysid.gap.adapters.mujoco.native import Change
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
    spec, native, left = _changed(model, tested, written)
    relocate(spec, model, out)
    try:
        write_spec(spec, out)
    except ValueError as error:
        raise InputError(out, f"MuJoCo refuses the repaired model ({error})", "masses and inertias of rigid bodies") from None
    adjusted = [change.effect for change in native if change.effect.name == ADJUSTED]
    study = steps.open_study(dataset, in_command_units(open_force_model(out, dataset).plant, adjusted))
    measured = stage_gap(study.case, study.stages, study.case.theta).before
    gap = replace(promised, after={signal: measured[signal] for signal in promised.after if signal in measured})
    if not left:
        check_gap(gap, promised, out)
    return RepairedModel(out, None, tuple(native), tuple(left), gap)


Written = tuple[Any, list[Change], list[KnownEffect]]


def _changed(model: Path, tested: Plant, written: Sequence[WrittenEffect]) -> Written:
    """The model with what has a place in it, what that is, and the other effects.

    What is adjusted without a name holds beside the other adjusted parameters only: a constant load beside the first moment of
    a link, for instance. Where MJCF has no place for one of them, none is written.
    """
    compiled, every = load_mjcf(model), [_known(row) for row in written]
    adjusted = [_known(row) for row in written if row.kind == "adjusted"]
    if all(item.name in WRITERS or item.name == ADJUSTED for item in adjusted):
        whole = _with_adjusted(model, compiled, tested, every)
        if whole is not None:
            return whole
    spec = load_spec(model)
    named = [_known(row) for row in written if row.kind != "adjusted"]
    native, left = write_inside(spec, compiled, tested.machine, named, model.name)
    return spec, native, [*left, *adjusted]


def _with_adjusted(model: Path, compiled: Any, tested: Plant, effects: Sequence[KnownEffect]) -> Written | None:
    """The same with everything; None where the model has no place for the inertial parameters."""
    spec, together = load_spec(model), any(item.name == ADJUSTED for item in effects)
    single = [item for item in effects if not (together and item.name in TOGETHER)]
    native, left = write_inside(spec, compiled, tested.machine, single, model.name)
    if not together:
        return spec, native, left
    plant = tested
    for item in effects:
        plant = plant.with_effect(item)
    changes = write_inertials(spec, compiled, plant, model.name)
    return None if changes is None else (spec, [*native, *changes], left)


def _known(row: WrittenEffect) -> KnownEffect:
    return KnownEffect(row.name, row.target, dict(row.parameters), row.side)  # type: ignore[arg-type]
