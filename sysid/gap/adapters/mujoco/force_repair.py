"""The repaired MJCF of force-driven axes: the model with the identified parameters, and its gap after it is loaded again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sysid.datasets.recording import Dataset
from sysid.errors import InputError
from sysid.gap import steps
from sysid.gap.adapters.mujoco.force_axes import open_force_model
from sysid.gap.adapters.mujoco.free_run import free_run_errors
from sysid.gap.adapters.mujoco.inertials import ADJUSTED, TOGETHER, in_command_units, write_inertials
from sysid.gap.adapters.mujoco.inside import WRITERS, write_inside
from sysid.gap.adapters.mujoco.native import Change
from sysid.gap.adapters.mujoco.repair import RepairedModel, check_gap, check_other_file, relocate, write_spec
from sysid.gap.gap_by_stage import stage_gap
from sysid.gap.noise import noise_levels
from sysid.gap.problem import split_of
from sysid.gap.result import Gap, WrittenEffect
from sysid.machine import KnownEffect
from sysid.machine.sources.mjcf_model import load_mjcf, load_spec
from sysid.plant import Plant
from sysid.plant.plant import effect_key

#: Why adjusted parameters are left out that the model cannot hold.
NO_PLACE = "the adjusted parameters hold together only, and MJCF has no place for one of them"


def write_force_model(
    model: Path,
    tested: Plant,
    written: Sequence[WrittenEffect],
    out: Path,
    dataset: Dataset,
    promised: Gap,
    assets: Sequence[Path] = (),
) -> RepairedModel:
    """Write the identified parameters into a copy of ``model``, load it again and measure its force errors.

    Named effects are written in any case. Parameters that were adjusted without a name are written if MuJoCo's free run of the
    selection recordings has a lower error with them than without: their forces agree, but a constant part of a torque that the
    recordings hardly determine is integrated.

    Args:
        tested: the plant of the model (:func:`sysid.gap.adapters.mujoco.force_axes.open_force_model`).
        promised: error of the forces at measured motion on held-out recordings, of the repaired plant.
        assets: further folders below which the model may open files.

    Raises:
        InputError: MuJoCo refuses the written model, or its error is larger than promised.
        SettingsError: ``out`` is the model itself.
    """
    check_other_file(model, out)
    chosen, folders = _with_named(model, tested, written, out, assets), (*assets, model.parent)
    adjusted = [_known(row) for row in written if row.kind == "adjusted"]
    why = ""
    if adjusted:
        whole = _with_all(model, tested, written, out, assets)
        why = NO_PLACE if whole is None else _worse_run(chosen, whole, tested, out, dataset, folders)
        if whole is not None and not why:
            chosen = whole
    try:
        write_spec(chosen.spec, out)
    except ValueError as error:
        raise InputError(out, f"MuJoCo refuses the repaired model ({error})", "masses and inertias of rigid bodies") from None
    inertials = [change.effect for change in chosen.native if change.effect.name == ADJUSTED]
    loaded = open_force_model(out, dataset, folders).plant
    study = steps.open_study(dataset, in_command_units(loaded, inertials))
    measured = stage_gap(study.case, study.stages, study.case.theta).before
    gap = replace(promised, after={signal: measured[signal] for signal in promised.after if signal in measured})
    left = (*chosen.left, *(adjusted if why else ()))
    if not left:
        check_gap(gap, promised, out)
    reasons = {effect_key(item): why for item in adjusted} if why else {}
    return RepairedModel(out, None, tuple(chosen.native), left, gap, reasons)


@dataclass(frozen=True)
class ChangedModel:
    """A model that is not written yet, what is in it, and the effects for which MJCF has no place."""

    spec: Any
    native: Sequence[Change]
    left: Sequence[KnownEffect]


def _with_named(
    model: Path, tested: Plant, written: Sequence[WrittenEffect], out: Path, assets: Sequence[Path]
) -> ChangedModel:
    """The model with everything but the adjusted parameters."""
    spec, compiled = load_spec(model, assets), load_mjcf(model, assets)
    named = [_known(row) for row in written if row.kind != "adjusted"]
    native, left = write_inside(spec, compiled, tested.machine, named, model.name)
    relocate(spec, model, out)
    return ChangedModel(spec, native, left)


def _with_all(
    model: Path, tested: Plant, written: Sequence[WrittenEffect], out: Path, assets: Sequence[Path]
) -> ChangedModel | None:
    """The model with everything.

    What is adjusted without a name holds beside the other adjusted parameters only: a constant load beside the first moment of
    a link, for instance. None where MJCF has no place for one of them.
    """
    effects = [_known(row) for row in written]
    if any(row.kind == "adjusted" and row.name not in WRITERS and row.name != ADJUSTED for row in written):
        return None
    spec, compiled = load_spec(model, assets), load_mjcf(model, assets)
    together = any(item.name == ADJUSTED for item in effects)
    single = [item for item in effects if not (together and item.name in TOGETHER)]
    native, left = write_inside(spec, compiled, tested.machine, single, model.name)
    if together:
        plant = tested
        for item in effects:
            plant = plant.with_effect(item)
        changes = write_inertials(spec, compiled, plant, model.name)
        if changes is None:
            return None
        native = [*native, *changes]
    relocate(spec, model, out)
    return ChangedModel(spec, native, left)


def _worse_run(
    named: ChangedModel, whole: ChangedModel, tested: Plant, out: Path, dataset: Dataset, folders: Sequence[Path]
) -> str:
    """Why the adjusted parameters are left out; empty where they lower the error of the free run.

    Both candidates are run from ``out``, which holds the last one afterwards; its files are below ``folders``.
    """
    select, noise, sizes = split_of(dataset).select, noise_levels(dataset), list[float]()
    for candidate in (named, whole):
        try:
            write_spec(candidate.spec, out)
        except ValueError as error:
            return f"MuJoCo refuses the model ({error})"
        inertials = [change.effect for change in candidate.native if change.effect.name == ADJUSTED]
        constants = {item.target: float(np.asarray(item.parameters["scale"])) for item in inertials}
        errors = free_run_errors(out, tested, select, constants, folders)
        if not errors:
            return "no selection recording has commands and positions of all axes"
        sizes.append(float(np.sqrt(np.mean([(value / noise[signal]) ** 2 for signal, value in errors.items()]))))
    before, after = sizes
    if np.isnan(after):
        return "the free run diverges"
    if after < before or np.isnan(before):
        return ""
    return f"the error of the free run rises from {before:.3g} to {after:.3g} standard deviations of the joint sensors"


def _known(row: WrittenEffect) -> KnownEffect:
    return KnownEffect(row.name, row.target, dict(row.parameters), row.side)  # type: ignore[arg-type]
