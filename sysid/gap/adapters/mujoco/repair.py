"""The repaired MJCF: effects in their native places, the others in a file beside it, and its gap after it is loaded again.

What cannot be written into the model is in ``<model>.effects.toml`` in its folder. The adapter loads it with the model: its
input effects act on the commands, its output effects on the signals.

The search applies effects to the commands at the time step of the model; native ones act inside its actuators, where a filter
and an interpolated delay differ by a part of a step. What has a native place is therefore fitted once more in place, from the
values found, by least squares on the fit and selection recordings.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from sysid.config import Strict, load_settings
from sysid.datasets.recording import Dataset
from sysid.effects import effect_named, input_delay
from sysid.errors import InputError, SettingsError
from sysid.files import written_whole
from sysid.gap.adapters.adapter import SimulatorAdapter, adapt_simulator
from sysid.gap.adapters.mujoco.native import Change, value_of, write_native
from sysid.gap.adapters.mujoco.simulator import MujocoSimulator
from sysid.gap.disagreement import run_rmse
from sysid.gap.prepare.noise import noise_levels
from sysid.gap.problem import split_of
from sysid.gap.result import Gap, WrittenEffect
from sysid.machine import EffectKey, KnownEffect
from sysid.machine.sources.mjcf_model import load_mjcf, load_spec, mjcf_text
from sysid.plant import effects_toml
from sysid.plant.plant import effect_key
from sysid.quoting import comment, toml_value

Array = npt.NDArray[np.float64]
E = TypeVar("E", KnownEffect, WrittenEffect)

#: Largest error of a loaded model beyond the promised one: a share of what the repair removes, or one noise floor.
TOLERANCE = 0.01
#: Most evaluations of the fit in place.
EVALUATIONS = 30


@dataclass(frozen=True)
class RepairedModel:
    """A repaired MJCF.

    Args:
        path, side_path: the model, and the file of the effects beside it, if there are any.
        native: effects in the model; ``beside``: those in the file, or left out where there is none.
        gap: errors on held-out recordings, of free runs or of forces at measured motion: ``before`` of the model under test,
            ``after`` of the file, loaded again.
        reasons: of effects that are left out although they were fitted: why.
        fitted: by how much the values, fitted once more to the free run, lower its error; empty where they are as found.
    """

    path: Path
    side_path: Path | None
    native: tuple[Change, ...]
    beside: tuple[KnownEffect, ...]
    gap: Gap
    reasons: Mapping[EffectKey, str] = field(default_factory=dict)
    fitted: str = ""


@dataclass(frozen=True)
class SideFile(Strict):
    """Content of the file."""

    schema: Literal[1]
    model: str
    effects: tuple[KnownEffect, ...] = ()


def side_file(model: Path) -> Path:
    """Path of the file that belongs to an MJCF."""
    return model.with_suffix(".effects.toml")


def read_side_file(model: Path) -> tuple[KnownEffect, ...]:
    """The effects beside an MJCF; none without the file.

    Raises:
        SettingsError: an unknown key or a wrong value.
    """
    path = side_file(model)
    return load_settings(path, SideFile).effects if path.is_file() else ()


def write_side_file(model: Path, effects: Sequence[KnownEffect]) -> None:
    """Write the effects beside an MJCF; without any, remove an earlier file."""
    if not effects:
        side_file(model).unlink(missing_ok=True)
        return
    name = comment(model.name)
    head = f"# Effects beside {name}, which MJCF cannot express. sysid gap --simulator mujoco:{name} loads them.\n"
    text = f"{head}schema = 1\nmodel = {toml_value(model.name)}\n\n{effects_toml(effects)}"
    with written_whole(side_file(model)) as half:
        half.write_text(text, "utf-8")


def open_mujoco(path: Path, dataset: Dataset, assets: Sequence[Path] = ()) -> SimulatorAdapter:
    """The simulator of an MJCF with the effects in the file beside it.

    Raises:
        InputError, SettingsError: as of :class:`MujocoSimulator` and :func:`read_side_file`.
    """
    return adapt_simulator(MujocoSimulator(path, dataset.machine, tuple(assets)), dataset, read_side_file(path))


def repaired_effects(adapter: SimulatorAdapter, written: Sequence[WrittenEffect]) -> tuple[KnownEffect, ...]:
    """Input and output effects after a repair: those of the simulation under test, changed and completed by ``written``.

    Effects whose values mean that they are absent are left out. A dead time below the time step of the model is that step if
    its 95 % interval contains it: MuJoCo has none between them.
    """
    effects, simulator = {effect_key(item): item for item in adapter.effects}, _simulator(adapter)
    step = float(load_mjcf(simulator.path, simulator.assets).opt.timestep)
    for row in written:
        item = known_effect(row)
        if row.name == input_delay.EFFECT.name and "delay" in row.interval95:
            low, high = (float(np.asarray(end)) for end in row.interval95["delay"])
            if low <= step <= high and value_of(item, "delay") < step:
                item = replace(item, parameters={**item.parameters, "delay": step})
        effects[effect_key(item)] = item
    return tuple(item for item in effects.values() if not _is_absent(item))


def known_effect(row: WrittenEffect) -> KnownEffect:
    """A written effect as an effect of a plant."""
    return KnownEffect(row.name, row.target, dict(row.parameters), row.side)  # type: ignore[arg-type]


def _simulator(adapter: SimulatorAdapter) -> MujocoSimulator:
    simulator = adapter.runs.simulator
    assert isinstance(simulator, MujocoSimulator)
    return simulator


def _is_absent(item: KnownEffect) -> bool:
    neutral = {slot.name: slot.neutral for slot in effect_named(item.name).slots}
    return all(name in neutral and value == neutral[name] for name, value in item.parameters.items())


def write_repaired(
    adapter: SimulatorAdapter, effects: Sequence[KnownEffect], out: Path, dataset: Dataset, promised: Gap
) -> RepairedModel:
    """Write the model with ``effects`` to ``out``, load it again and measure its gap.

    Args:
        adapter: the simulation under test, of :func:`open_mujoco`.
        promised: the gap of the repaired simulation on held-out recordings.

    Raises:
        InputError: the gap of the written model is larger than promised, by more than its noise floor and :data:`TOLERANCE`.
        SettingsError: ``out`` is the model itself.
    """
    simulator = _simulator(adapter)
    check_other_file(simulator.path, out)
    native, beside = _write(simulator, effects, out)
    if native:
        effects = [*_fitted_in_place(simulator, [change.effect for change in native], beside, out, dataset), *beside]
        native, beside = _write(simulator, effects, out)
    loaded = open_mujoco(out, dataset, _folders(simulator))
    measured = run_rmse([(recording, loaded.simulate(recording)) for recording in split_of(dataset).held_out])
    gap = measured_gap(promised, measured)
    check_gap(gap, promised, out)
    return RepairedModel(out, side_file(out) if beside else None, tuple(native), tuple(beside), gap)


def _write(simulator: MujocoSimulator, effects: Sequence[KnownEffect], out: Path) -> tuple[list[Change], list[KnownEffect]]:
    """Write the model and the file beside it; what went where."""
    spec, model = load_spec(simulator.path, simulator.assets), load_mjcf(simulator.path, simulator.assets)
    native, beside = write_native(spec, model, simulator.machine, effects, simulator.name)
    relocate(spec, simulator.path, out)
    write_spec(spec, out)
    write_side_file(out, beside)
    return native, beside


def _fitted_in_place(
    simulator: MujocoSimulator, native: Sequence[KnownEffect], beside: Sequence[KnownEffect], out: Path, dataset: Dataset
) -> list[KnownEffect]:
    """The native effects with the values that fit best inside the model."""
    places = [(k, name) for k, item in enumerate(native) for name in item.parameters]
    parameters = [_parameter(native[k].name, name) for k, name in places]
    start = np.array([value_of(native[k], name) for k, name in places])
    scale = np.array([parameter.negligible for parameter in parameters])
    low, high = (np.array([parameter.bounds[end] for parameter in parameters]) for end in (0, 1))
    noise, recordings = noise_levels(dataset), split_of(dataset).seen
    signals = [f"{axis.name}.{axis.drives}" for axis in dataset.machine.axes if axis.driven in noise]

    def residuals(values: Array) -> Array:
        _write(simulator, [*with_values(native, places, values), *beside], out)
        model = open_mujoco(out, dataset, _folders(simulator))
        parts = []
        for recording in recordings:
            table = model.simulate(recording)
            parts += [(table[s].to_numpy() - recording.values(s)) / noise[s] for s in signals if s in table]
        return np.nan_to_num(np.concatenate(parts))

    found = least_squares(
        residuals,
        np.clip(start, low, high),
        bounds=(low, high),
        x_scale=scale,
        diff_step=np.full(len(start), 1e-3),
        max_nfev=EVALUATIONS,
    )
    return with_values(native, places, found.x)


def with_values(effects: Sequence[E], places: Sequence[tuple[int, str]], values: Array) -> list[E]:
    """The effects with other values of the parameters at ``places``: number of the effect, name of the parameter."""
    found = list(effects)
    for (k, name), value in zip(places, values, strict=True):
        found[k] = replace(found[k], parameters={**found[k].parameters, name: float(value)})
    return found


def _folders(simulator: MujocoSimulator) -> tuple[Path, ...]:
    """Where the written model finds the files of the one under test."""
    return (*simulator.assets, simulator.path.parent)


def _parameter(effect: str, name: str) -> Any:
    return next(p for form in effect_named(effect).forms for p in form.parameters if p.name == name)


def check_other_file(model: Path, out: Path) -> None:
    """Check that the model under test is not overwritten.

    Raises:
        SettingsError: ``out`` is the model.
    """
    if out.exists() and out.samefile(model):
        raise SettingsError(f"--out {out}", "the model under test", "another file")


def write_spec(spec: Any, out: Path) -> None:
    """Compile a model and write it as MJCF.

    Raises:
        ValueError: MuJoCo refuses it.
    """
    text = mjcf_text(spec)
    out.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(out) as half:
        half.write_text(text, "utf-8")


def relocate(spec: Any, source: Path, out: Path) -> None:
    """Folders of meshes and textures, seen from the folder of the written file."""
    for key in ("meshdir", "texturedir"):
        folder = source.parent / str(getattr(spec, key) or "")
        setattr(spec, key, os.path.relpath(folder.resolve(), out.parent.resolve()))


def measured_gap(promised: Gap, measured: Mapping[str, float]) -> Gap:
    """The promised gap with the errors that the loaded model has."""
    return replace(promised, after={signal: measured[signal] for signal in promised.after if signal in measured})


def check_gap(gap: Gap, promised: Gap, out: Path) -> None:
    """Whether the loaded model does as promised.

    Raises:
        InputError: it does not.
    """
    for signal, value in gap.after.items():
        removed = max(promised.before[signal] - promised.after[signal], 0.0)
        allowed = promised.after[signal] + max(TOLERANCE * removed, promised.noise_floor[signal])
        if value > allowed:
            raise InputError(
                out, f"{signal}: the error of the written model is {value:.3g}", f"at most {allowed:.3g}, as promised"
            )
