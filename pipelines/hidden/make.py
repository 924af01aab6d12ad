"""Makes a case: ``site/`` with logs and description, and separately the truth.

<work>/cases/<name>/site/…         logs, machine.toml, recipe.toml: all that the run of the workflow sees
<work>/sealed/<name>.json          what is hidden, how large, how far above its detection limit, and the case itself
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from agreement.fitting import Unknown, fit
from agreement.machines import description, parsed, record
from hidden.cases import CaseSpec, Hidden
from hidden.kinds import BY_KEY, Kind
from hidden.limits import Limit, error_of, limit_of, overlaid_lists
from hidden.machines import Tables, recorded, visible_tables
from simulated_bench.case import BenchCase, write_case
from simulated_bench.joint_machines import write_joint_machine
from simulated_bench.joint_recipe import ServoArm, Slide
from simulated_bench.nominal import CommandChain, fit_nominal
from simulated_bench.recipe import BenchRecipe, HiddenSettings
from sysid.plant import nominal_plant

#: Effects of the nominal plant of a servo.
SERVO = ("input_delay", "first_order_lag")


def make_case(spec: CaseSpec, work: Path, nominal_plants: Path | None = None) -> dict[str, Any]:
    """Write the case; returns what is sealed.

    Args:
        nominal_plants: where the owners' fitted plants are kept, which every seed shares; ``work/nominal`` if not given.
    """
    known = with_known(visible_tables(spec.family, spec.variant), spec, BY_KEY)
    visible = recorded(known, spec.excitation, spec.noise, spec.disturbance, spec.seed)
    owner = parsed(visible, spec.name)
    nominal = kept_nominal(owner, nominal_plants or work / "nominal") if isinstance(owner, BenchRecipe) else None
    hidden = []
    real_tables = visible
    for each in spec.hidden:
        kind = BY_KEY[each.kind]
        limit = limit_of(kind, each.direction, visible, error_of(kind, visible, nominal))
        magnitude, described = hide(each, kind, limit)
        real_tables = overlaid_lists(real_tables, kind.change(visible, magnitude, each.direction))
        hidden.append(described)
    real = parsed(real_tables, spec.name)
    out = work / "cases" / spec.name
    if isinstance(owner, BenchRecipe) and isinstance(real, BenchRecipe):
        named = [effect for each in spec.hidden for effect in BY_KEY[each.kind].named]
        case = BenchCase("crane", owner, real, tuple(HiddenSettings(name, target) for name, target in named))
        truth = write_case(case, out, nominal)
        (out / "truth" / "truth.json").unlink()
        (out / "truth").rmdir()
        effects, error = truth["effects"], truth["model_error"]
    else:
        assert isinstance(owner, ServoArm | Slide)
        assert isinstance(real, ServoArm | Slide)
        effects, error = _write_joints(owner, real, spec.hidden, out / "site"), {}
    return write_sealed(work, spec, hidden, effects, error)


def write_sealed(
    work: Path, spec: CaseSpec, hidden: list[dict[str, Any]], effects: list[dict[str, Any]], error: dict[str, Any]
) -> dict[str, Any]:
    """Write the truth of a case, and return it."""
    sealed = {"spec": spec.to_json(), "hidden": hidden, "effects": effects, "model_error": error}
    path = work / "sealed" / f"{spec.name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(sealed, indent=1) + "\n", "utf-8")
    return sealed


def with_known(tables: Tables, spec: CaseSpec, kinds: Mapping[str, Kind]) -> Tables:
    """The machine of a case as its owner describes it, without its recordings: ``tables`` with what its kinds need."""
    for each in spec.hidden:
        tables = overlaid_lists(tables, kinds[each.kind].known)
    return tables


def hide(each: Hidden, kind: Kind, limit: Limit) -> tuple[float, dict[str, Any]]:
    """Magnitude of a hidden effect, within its plausible range, and its description; ``factor`` is that of this magnitude."""
    magnitude = min(max(each.factor * limit.magnitude, kind.least), kind.most)
    shows = math.isfinite(limit.magnitude)
    return magnitude, {
        "kind": each.kind,
        "effects": [{"name": name, "target": target} for name, target in kind.named],
        "magnitude": magnitude,
        "detection_limit": limit.magnitude if shows else None,
        "factor": magnitude / limit.magnitude if shows else 0.0,
        "judged": kind.evaluated,
    }


def write_recipe(site: Path, name: str, recordings: Sequence[str]) -> None:
    """``recipe.toml`` of logs with canonical names; the last recording is held out."""
    listed = ", ".join(f'"{each}"' for each in recordings)
    (site / "recipe.toml").write_text(
        f'schema = 1\nname = "{name}"\nmachine = "machine.toml"\nlogs = "logs"\n[recordings]\nmotion = [{listed}]\n'
        f'[splits]\nheld_out = ["{recordings[-1]}"]\n',
        "utf-8",
    )


def kept(folder: Path, key: str, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """The JSON file in ``folder`` for ``key``, made where it is missing."""
    path = folder / f"{sha256(key.encode()).hexdigest()[:16]}.json"
    if not path.exists():
        made = make()
        folder.mkdir(parents=True, exist_ok=True)
        beside = path.with_suffix(".part")
        beside.write_text(json.dumps(made), "utf-8")
        beside.replace(path)
    found: dict[str, Any] = json.loads(path.read_text("utf-8"))
    return found


def kept_nominal(owner: BenchRecipe, folder: Path) -> CommandChain:
    """The owner's fitted plant of a crane; it depends neither on recordings nor on noise and is fitted once for each."""
    machine = (owner.geometry, owner.axes, owner.masses, owner.supply, owner.oil, owner.gripper.length, owner.step)
    disturbance = owner.axis("slew").valve.disturbance

    def fitted() -> dict[str, Any]:
        chain = fit_nominal(owner)
        return {"rows": chain.rows.tolist(), "gains": chain.gains.tolist()}

    found = kept(folder, repr(machine).replace(f"disturbance={disturbance!r}", ""), fitted)
    return CommandChain(np.array(found["rows"]), np.array(found["gains"]))


# ---- Joint machines -----------------------------------------------------------------------------------------------------


def _write_joints(
    owner: ServoArm | Slide, real: ServoArm | Slide, hidden: Sequence[Hidden], site: Path
) -> list[dict[str, Any]]:
    """Write the logs of the real machine and the owner's description; returns the exact truth."""
    write_joint_machine(real, site / "logs")
    description = site / "logs" / "machine.toml"
    text = write_known(owner, description.read_text("utf-8"))
    if isinstance(owner, Slide):
        assert isinstance(real, Slide)
        text = text.replace(f"inertia = {real.mass}", f"inertia = {owner.mass}")
    for path in (site / "logs").glob("*.*"):
        path.rename(site / path.name)
    (site / "machine.toml").write_text(text, "utf-8")
    write_recipe(site, "joints", [take.name for take in owner.recordings])
    return [effect for each in hidden for effect in _joint_truth(BY_KEY[each.kind], owner, real)]


def write_known(owner: ServoArm | Slide, text: str) -> str:
    """The description with the known effects."""
    known: list[tuple[str, str, dict[str, float]]] = []
    if isinstance(owner, ServoArm):
        for axis in owner.axes:
            known += [(name, axis.name, values) for name, values in fitted_servo(owner, axis.name).items()]
    else:
        known += [("viscous_friction", "carriage", {"coefficient": owner.viscous})]
        if owner.coulomb > 0.0:
            known += [("coulomb_friction", "carriage", {"force": owner.coulomb})]
    for name, target, values in known:
        listed = ", ".join(f"{key} = {value}" for key, value in values.items())
        text += f'\n[[effects]]\nname = "{name}"\ntarget = "{target}"\nparameters = {{ {listed} }}\n'
    return text


def fitted_servo(arm: ServoArm, axis: str) -> dict[str, dict[str, float]]:
    """Dead time and lag as an engineer fits them without noise, the cycle before the servo begins to follow included."""
    plant = nominal_plant(description(arm))
    unknowns = [Unknown("input_delay", axis, {"delay": 0.04}), Unknown("first_order_lag", axis, {"time_constant": 0.05})]
    plant = fit(plant, unknowns, [record(arm, "operator", 1, 30.0)], (f"{axis}.joint",))
    found = {name: plant.effect(name, axis) for name in SERVO}
    return {name: {key: float(value) for key, value in effect.parameters.items()} for name, effect in found.items() if effect}  # type: ignore[arg-type]


def _joint_truth(kind: Kind, owner: ServoArm | Slide, real: ServoArm | Slide) -> list[dict[str, Any]]:
    found = []
    for name, target in kind.named:
        if isinstance(real, ServoArm):
            axis = next(axis for axis in real.axes if axis.name == target)
            values = {
                **(fitted_servo(real, target) if name in SERVO else {}),
                "command_rate_limit": {"rate": axis.rate_limit},
                "backlash": {"width": axis.backlash},
                "joint_compliance": {"compliance": axis.compliance},
            }[name]
        else:
            assert isinstance(owner, Slide)
            values = {
                "coulomb_friction": {"force": real.coulomb},
                "viscous_friction": {"coefficient": real.viscous},
                # In addition to the known Coulomb friction.
                "stribeck_friction": {
                    "static_force": real.static - owner.coulomb,
                    "coulomb_force": real.coulomb - owner.coulomb,
                    "stribeck_velocity": real.stribeck,
                },
                "inertia_error": {"ratio": real.mass / owner.mass},
                "load_bias": {"force": real.offset},
            }[name]
        found.append({"name": name, "target": target, "parameters": values, "exact": True})
    return found
