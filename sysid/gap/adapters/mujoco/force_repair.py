"""The repaired MJCF of force-driven axes: the model with the identified parameters, and its gap after it is loaded again."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from sysid.datasets.recording import Dataset
from sysid.errors import InputError
from sysid.gap import steps
from sysid.gap.adapters.mujoco.force_axes import open_force_model
from sysid.gap.adapters.mujoco.force_fit import fitted_to_run
from sysid.gap.adapters.mujoco.free_run import Differences, Stretch, stretches_to_run
from sysid.gap.adapters.mujoco.inertials import ADJUSTED, TOGETHER, in_command_units, write_inertials
from sysid.gap.adapters.mujoco.inside import WRITERS, write_inside
from sysid.gap.adapters.mujoco.native import Change
from sysid.gap.adapters.mujoco.repair import RepairedModel, check_gap, check_other_file, relocate, write_spec
from sysid.gap.adapters.mujoco.simulator import MujocoSimulator
from sysid.gap.disagreement import stage_gap
from sysid.gap.noise import noise_levels
from sysid.gap.problem import split_of
from sysid.gap.result import Gap, WrittenEffect
from sysid.machine import KnownEffect
from sysid.machine.sources.mjcf_model import load_mjcf, load_spec
from sysid.plant import Plant
from sysid.plant.plant import effect_key

#: Builds the model with some effects.
Build = Callable[[Sequence[WrittenEffect]], "ChangedModel | None"]
#: Why adjusted parameters are left out that the model cannot hold.
NO_PLACE = "the adjusted parameters hold together only, and MJCF has no place for one of them"
#: Why nothing can be compared.
NO_RUN = "no selection recording has commands and positions of all axes"
#: What a fit to the free run changed, and the unit of its error.
FITTED, IN_NOISE = "error of the free run on selection recordings", "standard deviations of the joint sensors"


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
        InputError: MuJoCo refuses the written model, or its error with the values of the result is larger than promised.
        SettingsError: ``out`` is the model itself.
    """
    check_other_file(model, out)
    repair = Repair(model, tested, out, dataset, assets)
    named, adjusted = [row for row in written if row.kind != "adjusted"], [_known(r) for r in written if r.kind == "adjusted"]
    chosen, why = repair.fitted(repair.with_named(named), named, repair.with_named), ""
    whole = repair.with_all(written) if adjusted else None
    if whole is not None:
        whole = repair.fitted(whole, written, repair.with_all)
        why = _worse(chosen, whole)
        chosen = chosen if why else whole
    elif adjusted:
        why = NO_PLACE
    repair.write(chosen)
    loaded = open_force_model(out, dataset, repair.folders).plant
    study = steps.open_study(dataset, in_command_units(loaded, chosen.inertials))
    measured = stage_gap(study.case, study.stages, study.case.theta).before
    gap = replace(promised, after={signal: measured[signal] for signal in promised.after if signal in measured})
    left = (*chosen.left, *(adjusted if why else ()))
    if not left and not chosen.fitted:
        check_gap(gap, promised, out)
    reasons = {effect_key(item): why for item in adjusted} if why else {}
    return RepairedModel(out, None, tuple(chosen.native), left, gap, reasons, chosen.fitted)


@dataclass(frozen=True)
class ChangedModel:
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

    @property
    def constants(self) -> dict[str, float]:
        """Axis → force constant relative to the recorded commands; 1 where it is absent."""
        return {item.target: float(np.asarray(item.parameters["scale"])) for item in self.inertials}


@dataclass(frozen=True)
class Repair:
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
    def fit(self) -> Sequence[Stretch]:
        return stretches_to_run(self.tested, split_of(self.dataset).fit)

    @cached_property
    def select(self) -> Sequence[Stretch]:
        return stretches_to_run(self.tested, split_of(self.dataset).select)

    def with_named(self, rows: Sequence[WrittenEffect]) -> ChangedModel:
        """The model with everything but the adjusted parameters."""
        spec, compiled = load_spec(self.model, self.assets), load_mjcf(self.model, self.assets)
        named = [_known(row) for row in rows if row.kind != "adjusted"]
        native, left = write_inside(spec, compiled, self.tested.machine, named, self.model.name)
        relocate(spec, self.model, self.out)
        return ChangedModel(spec, native, left)

    def with_all(self, rows: Sequence[WrittenEffect]) -> ChangedModel | None:
        """The model with everything.

        What is adjusted without a name holds beside the other adjusted parameters only: a constant load beside the first
        moment of a link, for instance. None where MJCF has no place for one of them.
        """
        effects = [_known(row) for row in rows]
        if any(row.kind == "adjusted" and row.name not in WRITERS and row.name != ADJUSTED for row in rows):
            return None
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
        return ChangedModel(spec, native, left)

    def fitted(self, found: ChangedModel, rows: Sequence[WrittenEffect], build: Build) -> ChangedModel:
        """The model with the values of the result, or with those that fit the free run if this lowers its error."""
        found = self._run(found)
        if not np.isfinite(found.error):
            return found

        def opened(changed: Sequence[WrittenEffect]) -> tuple[MujocoSimulator, Mapping[str, float]]:
            candidate = build(changed)
            if candidate is None:
                raise InputError(self.out, "values without a place in MJCF", "others")
            return self._open(candidate)

        refined = build(fitted_to_run(rows, self.fit, self.noise, opened))
        other = found if refined is None else self._run(refined)
        if not other.error < found.error:
            return found
        return replace(other, fitted=f"{FITTED} from {found.error:.3g} to {other.error:.3g} {IN_NOISE}")

    def _run(self, candidate: ChangedModel) -> ChangedModel:
        """A candidate with the error of its free run."""
        try:
            runs = Differences(*self._open(candidate), self.noise)
        except InputError as refusal:
            return replace(candidate, why=refusal.found)
        try:
            error = runs.rms(self.select)
        except InputError:
            return replace(candidate, why="the free run diverges")
        return replace(candidate, error=error, why=NO_RUN if np.isnan(error) else "")

    def _open(self, candidate: ChangedModel) -> tuple[MujocoSimulator, Mapping[str, float]]:
        """A candidate written to ``out``, and its force constants.

        Raises:
            InputError: MuJoCo refuses it.
        """
        self.write(candidate)
        return MujocoSimulator(self.out, self.tested.machine, self.folders), candidate.constants

    def write(self, candidate: ChangedModel) -> None:
        """Write it to ``out``.

        Raises:
            InputError: MuJoCo refuses it.
        """
        try:
            write_spec(candidate.spec, self.out)
        except ValueError as error:
            found = f"MuJoCo refuses the repaired model ({error})"
            raise InputError(self.out, found, "masses and inertias of rigid bodies") from None


def _worse(named: ChangedModel, whole: ChangedModel) -> str:
    """Why the adjusted parameters are left out; empty where they lower the error of the free run."""
    if whole.why:
        return whole.why
    if np.isnan(named.error) or whole.error < named.error:
        return ""
    return f"the error of the free run rises from {named.error:.3g} to {whole.error:.3g} {IN_NOISE}"


def _known(row: WrittenEffect) -> KnownEffect:
    return KnownEffect(row.name, row.target, dict(row.parameters), row.side)  # type: ignore[arg-type]
