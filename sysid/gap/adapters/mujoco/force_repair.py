"""Force-driven axes of a MuJoCo model: friction, inertia and masses are parameters of the model itself.

The plant with the same axes, masses, armature, damping and friction loss needs the same forces for a measured motion as the
model; this is checked with MuJoCo's inverse dynamics on the recordings. Its effects are therefore searched on that plant, and
written into the joints, bodies and actuators of the model. The written model is loaded again and its gap measured.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from sysid.datasets.recording import Dataset, Recording
from sysid.errors import InputError, SettingsError
from sysid.gap import steps
from sysid.gap.adapters.mujoco.free_run import Differences, fitted_to_run, stretches_to_run
from sysid.gap.adapters.mujoco.native import (
    ADJUSTED,
    INSIDE,
    TOGETHER,
    Change,
    in_command_units,
    value_of,
    write_inertials,
    write_inside,
)
from sysid.gap.adapters.mujoco.repair import (
    RepairedModel,
    check_gap,
    check_other_file,
    known_effect,
    measured_gap,
    relocate,
    write_spec,
)
from sysid.gap.adapters.mujoco.simulator import MujocoSimulator, drives_of
from sysid.gap.disagreement import stage_gap
from sysid.gap.prepare.noise import noise_levels
from sysid.gap.problem import split_of
from sysid.gap.result import Gap, WrittenEffect
from sysid.machine import KnownEffect, Machine, machine_from_files
from sysid.machine.rigid_body import rigid_body
from sysid.machine.sources.draft import machine_text
from sysid.machine.sources.mjcf import mjcf_draft
from sysid.machine.sources.mjcf_model import load_mjcf, load_spec, mujoco_library
from sysid.names import listed
from sysid.plant import Plant, compile_plant, nominal_plant
from sysid.plant.link_torque import link_motion
from sysid.plant.plant import effect_key

#: Rows of a recording at which both inverse dynamics are compared.
ROWS = 200
#: Largest RMS difference of their torques, as a share of the RMS torque; standard gravity differs by 0.03 % from MuJoCo's.
TOLERANCE = 0.01
#: Why adjusted parameters are left out that the model cannot hold.
NO_PLACE = "the adjusted parameters hold together only, and MJCF has no place for one of them"
#: Why nothing can be compared.
NO_RUN = "no selection recording has commands and positions of all axes"
#: What a fit to the free run changed, and the unit of its error.
FITTED, IN_NOISE = "error of the free run on selection recordings", "standard deviations of the joint sensors"


def is_force_driven(machine: Machine) -> bool:
    """Whether every axis is."""
    return all(axis.actuation == "force" for axis in machine.axes)


def open_force_model(path: Path, dataset: Dataset, assets: Sequence[Path] = ()) -> Plant:
    """The plant of a model whose axes are all driven by forces; arguments as of :func:`sysid.gap.adapters.mujoco.open_model`.

    Raises:
        InputError: not a file that MuJoCo compiles, or it needs other forces than the plant (springs, contacts).
        SettingsError: its axes are not those of the dataset.
    """
    machine, model = machine_of(path, dataset.machine, assets), load_mjcf(path, assets)
    plant = nominal_plant(machine, streams=dataset.streams)
    _check_forces(path, model, plant, dataset)
    return plant


def machine_of(path: Path, machine: Machine, assets: Sequence[Path] = ()) -> Machine:
    """The machine that the model describes, with names, rate, sensor noise and convention of ``machine``.

    Raises:
        SettingsError: other axes.
    """
    draft = mjcf_draft(path, machine.tip, machine.tool, assets=assets)
    found = [axis.joint for axis in draft.axes]
    wanted = [axis.joint or axis.name for axis in machine.axes]
    if found != wanted:
        expected = f"{listed(wanted)}, the joints of machine.toml"
        raise SettingsError(
            path.name, f"driven joints {listed(found)}", expected, f"sysid init --from {path.name} describes it."
        )
    axes = tuple(
        replace(axis, name=own.name, effects=tuple(replace(e, target=own.name) for e in axis.effects))
        for axis, own in zip(draft.axes, machine.axes, strict=True)
    )
    text = machine_text(replace(draft, axes=axes), machine.name)
    own = machine_from_files({"machine.toml": text, f"{machine.name}.urdf": draft.urdf}, path.name)
    return replace(own, rate_hz=machine.rate_hz, noise=machine.noise, convention=machine.convention)


def _check_forces(path: Path, model: Any, plant: Plant, dataset: Dataset) -> None:
    """Compare the torques of both at measured motion, without friction; an error where they differ."""
    mujoco, body = mujoco_library(), rigid_body(plant.machine)
    drives = drives_of(model, plant.machine, path.name).values()
    if body is None:
        return
    model.dof_damping[:] = model.dof_frictionloss[:] = 0.0
    model.actuator_damping[:] = 0.0
    data, compiled = mujoco.MjData(model), compile_plant(plant)
    places = [int(model.jnt_qposadr[drive.joint]) for drive in drives]
    dofs = [int(model.jnt_dofadr[drive.joint]) for drive in drives]
    rotors = np.array([axis.inertia or 0.0 for axis in plant.machine.axes])
    for recording in split_of(dataset).seen[:1]:
        motion = link_motion(compiled, recording)
        if motion is None:
            return
        rows = np.linspace(0, len(recording) - 1, ROWS).astype(int)
        q, v, a = (part[rows] for part in motion)
        own = body.torque(q, v, a, body.nominal) + rotors * a
        theirs = np.empty_like(own)
        for k in range(len(rows)):
            data.qpos[places], data.qvel[dofs], data.qacc[dofs] = q[k], v[k], a[k]
            mujoco.mj_inverse(model, data)
            theirs[k] = data.qfrc_inverse[dofs]
        for axis, ours, other in zip(plant.machine.axis_names, own.T, theirs.T, strict=True):
            difference, size = (float(np.sqrt(np.mean(x**2))) for x in (ours - other, other))
            if difference > TOLERANCE * size:
                found = f"{axis}: its torques differ by {difference:.3g} of {size:.3g} from those of its masses and rotors"
                raise InputError(path, found, f"at most {TOLERANCE:.0%}", "Remove springs, contacts and tendons at the axes.")


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
        tested: of :func:`open_force_model`.
        promised: error of the forces at measured motion on held-out recordings, of the repaired plant.

    Raises:
        InputError: MuJoCo refuses the written model, or its error with the values of the result is larger than promised.
        SettingsError: ``out`` is the model itself.
    """
    check_other_file(model, out)
    repair = _Repair(model, tested, out, dataset, assets)
    adjusted, why = [row for row in written if row.kind == "adjusted"], ""
    chosen = repair.fitted([row for row in written if row.kind != "adjusted"])
    assert chosen is not None  # what is not adjusted has a place, or is left out by itself
    if adjusted:
        whole = repair.fitted(written)
        why = NO_PLACE if whole is None else _worse(chosen, whole)
        chosen = chosen if whole is None or why else whole
    repair.write(chosen)
    loaded = open_force_model(out, dataset, repair.folders)
    study = steps.open_study(dataset, in_command_units(loaded, chosen.inertials))
    measured = stage_gap(study.case, study.stages, study.case.theta).before
    gap = measured_gap(promised, measured)
    left_out = [known_effect(row) for row in adjusted] if why else []
    left = (*chosen.left, *left_out)
    if not left and not chosen.fitted:
        check_gap(gap, promised, out)
    reasons = {effect_key(item): why for item in left_out}
    return RepairedModel(out, None, tuple(chosen.native), left, gap, reasons, chosen.fitted)


@dataclass(frozen=True)
class _ChangedModel:
    """A model that is not written yet, what is in it, and the effects for which MJCF has no place.

    Args:
        error: of the free run on selection recordings [standard deviations of the joint sensors]; NaN where there is none.
        why: there is none: it diverges, MuJoCo refuses the model, or nothing can be compared.
        fitted: what a fit of the values to the free run changed.
    """

    spec: Any
    native: Sequence[Change]
    left: Sequence[KnownEffect]
    error: float = np.nan
    why: str = ""
    fitted: str = ""

    @property
    def inertials(self) -> list[KnownEffect]:
        """The adjusted inertial parameters in it."""
        return [change.effect for change in self.native if change.effect.name == ADJUSTED]


@dataclass(frozen=True)
class _Repair:
    """The model under test, its plant, where the repaired one is written, and the recordings.

    ``out`` holds the candidate that was run last; files that it opens are below ``folders``.
    """

    model: Path
    tested: Plant
    out: Path
    dataset: Dataset
    assets: Sequence[Path]

    @property
    def folders(self) -> tuple[Path, ...]:
        return (*self.assets, self.model.parent)

    @cached_property
    def noise(self) -> Mapping[str, float]:
        """Signal → standard deviation of its sensor."""
        return noise_levels(self.dataset)

    @cached_property
    def fit(self) -> Sequence[Recording]:
        return stretches_to_run(self.tested, split_of(self.dataset).fit)

    @cached_property
    def select(self) -> Sequence[Recording]:
        return stretches_to_run(self.tested, split_of(self.dataset).select)

    def changed(self, rows: Sequence[WrittenEffect]) -> _ChangedModel | None:
        """The model with some effects; None where MJCF has no place for one that is adjusted.

        What is adjusted without a name holds beside the other adjusted parameters only: a constant load beside the first
        moment of a link, for instance.
        """
        if any(row.kind == "adjusted" and row.name not in (*INSIDE, ADJUSTED) for row in rows):
            return None
        effects = [known_effect(row) for row in rows]
        spec, compiled = load_spec(self.model, self.assets), load_mjcf(self.model, self.assets)
        together = any(item.name == ADJUSTED for item in effects)
        single = [item for item in effects if not (together and item.name in TOGETHER)]
        native, left = write_inside(spec, compiled, self.tested.machine, single, self.model.name)
        if together:
            plant = self.tested
            for item in effects:
                plant = plant.with_effect(item)
            changes = write_inertials(spec, compiled, plant, self.model.name)
            if changes is None:
                return None
            native = [*native, *changes]
        relocate(spec, self.model, self.out)
        return _ChangedModel(spec, native, left)

    def fitted(self, rows: Sequence[WrittenEffect]) -> _ChangedModel | None:
        """The model with the values of the result, or with those that fit the free run if this lowers its error."""
        found = self.changed(rows)
        if found is None:
            return None
        found = self._run(found)
        if not np.isfinite(found.error):
            return found

        def opened(other: Sequence[WrittenEffect]) -> Differences:
            candidate = self.changed(other)
            if candidate is None:
                raise InputError(self.out, "values without a place in MJCF", "others")
            return self._open(candidate)

        refined = self.changed(fitted_to_run(rows, self.fit, opened))
        other = found if refined is None else self._run(refined)
        if not other.error < found.error:
            return found
        return replace(other, fitted=f"{FITTED} from {found.error:.3g} to {other.error:.3g} {IN_NOISE}")

    def _run(self, candidate: _ChangedModel) -> _ChangedModel:
        """A candidate with the error of its free run."""
        try:
            runs = self._open(candidate)
        except InputError as refusal:
            return replace(candidate, why=refusal.found)
        try:
            error = runs.rms(self.select)
        except InputError:
            return replace(candidate, why="the free run diverges")
        return replace(candidate, error=error, why=NO_RUN if np.isnan(error) else "")

    def _open(self, candidate: _ChangedModel) -> Differences:
        """Free runs of a candidate, written to ``out``."""
        self.write(candidate)
        simulator = MujocoSimulator(self.out, self.tested.machine, self.folders)
        constants = {item.target: value_of(item, "scale") for item in candidate.inertials}
        return Differences(simulator, constants, self.noise)

    def write(self, candidate: _ChangedModel) -> None:
        """Write it to ``out``; an error where MuJoCo refuses it."""
        try:
            write_spec(candidate.spec, self.out)
        except ValueError as error:
            found = f"MuJoCo refuses the repaired model ({error})"
            raise InputError(self.out, found, "masses and inertias of rigid bodies") from None


def _worse(named: _ChangedModel, whole: _ChangedModel) -> str:
    """Why the adjusted parameters are left out; empty where they lower the error of the free run."""
    if whole.why:
        return whole.why
    if np.isnan(named.error) or whole.error < named.error:
        return ""
    return f"the error of the free run rises from {named.error:.3g} to {whole.error:.3g} {IN_NOISE}"
