"""``README.md`` of an export: what it is, its units and frames, how each effect is represented, and the replay."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from sysid.display import quantity
from sysid.effects import Effect, effect_named
from sysid.effects.units import parameter_unit
from sysid.effects.wording import title_of
from sysid.export.names import Renamed
from sysid.export.posterior import RANGES, SAMPLES, WARNING
from sysid.export.replay import ROUNDING, RUN, SHARE, Replay
from sysid.export.target import Support, Target
from sysid.machine import KnownEffect
from sysid.machine.rigid_body import moves_masses
from sysid.plant import Plant
from sysid.quoting import code, markdown
from sysid.signals import split_signal

#: Kinds of axes that may move links with masses.
LINKED: tuple[Literal["force", "servo"], ...] = ("force", "servo")
KINDS = {
    "native": "native",
    "composed": "composed",
    "plugin": "by plugin",
    "not_representable": "not representable",
}


def export_page(
    plant: Plant, target: Target, rate_hz: float, files: Sequence[str], found: Replay | str, units: Mapping[str, str]
) -> str:
    """The page as Markdown.

    Args:
        found: the replay, or why it was not run.
        units: of the measured signals.
    """
    reference = plant.reference or plant.machine.name
    parts = [
        f"# {markdown(reference)} for {target.title}\n",
        f"Machine {code(plant.machine.name)}, written by {code(f'sysid export {reference} --to {target.name}')}.\n",
        f"Files: {', '.join(map(code, files))}.\n",
        "## Conventions\n",
        f"- Units are SI: m, rad, s, N, N·m, kg. A sample is {1.0 / rate_hz:g} s.",
        "- Frame: that in which the end effector was measured; z is up in the base frame of the URDF. Joint values are those",
        "  of the URDF, positive about or along its axes. `joint_offset`: structure = sensor + offset.",
        "- Commands are those of `machine.toml`: " + "; ".join(map(_command, plant.machine.axes)) + ".",
        *(f"- {note}" for note in target.notes),
        "",
        *_names(target.names(plant).changed),
        "## Effects\n",
        *_effects(plant, target),
        "## Replay\n",
        *_replay(target, found, units),
        "## Uncertainty\n",
        *_uncertainty(plant, files),
        "## Lineage\n",
        *(_lineage(plant) or ["- none"]),
        "",
    ]
    return "\n".join(parts)


def _lineage(plant: Plant) -> list[str]:
    origin = plant.origin.items()
    return [f"- {markdown(key)}: {code(str(value))}" for key, value in origin if isinstance(value, (str, int, float))]


def _names(renamed: Sequence[Renamed]) -> list[str]:
    if not renamed:
        return []
    lines = [f"- {part.kind} {code(part.name)}: {code(part.written)}" for part in renamed]
    return ["## Names\n", "The format reserves some names, cannot hold others, or has them already:\n", *lines, ""]


def _command(axis: Any) -> str:
    if axis.follows_positions:
        return f"{code(axis.name)} position"
    meaning = {"velocity": f"±1 is ±{axis.gain:g} of its speed unit per second", "force": "force"}
    return f"{code(axis.name)} {meaning[axis.actuation]}"


def _effects(plant: Plant, target: Target) -> list[str]:
    if not plant.effects and not plant.residuals:
        return ["The plant has no effects.\n"]
    rows = ["| effect | target | parameters | represented | how |", "| --- | --- | --- | --- | --- |"]
    for item in plant.effects:
        effect = effect_named(item.name)
        support = support_in(plant, target, effect)
        where = f"{item.target}{f', {item.side}' if item.side else ''}"
        title = title_of(effect, item.target, plant.machine)
        cells = (
            f"{markdown(title)} ({code(item.name)})",
            markdown(where),
            _values(plant, item),
            KINDS[support.kind],
            support.how,
        )
        rows.append(f"| {' | '.join(cells)} |")
    for residual in plant.residuals:
        where = f"({markdown(residual.stage)}) | {markdown(residual.target)}"
        rows.append(f"| `unnamed_residual` {where} | | not representable | a network |")
    return [*rows, ""]


def _values(plant: Plant, item: KnownEffect) -> str:
    values = []
    for name, value in item.parameters.items():
        unit = parameter_unit(item.name, name, item.target, plant.machine)
        texts = [f"{x:.6g}" for x in np.atleast_1d(np.asarray(value, dtype=np.float64))]
        values.append(f"{name} {', '.join(texts)}{f' {unit}' if unit != '1' else ''}")
    return "; ".join(values)


def _replay(target: Target, found: Replay | str, units: Mapping[str, str]) -> list[str]:
    if isinstance(found, str):
        return [f"{found}\n"]
    where = f"{markdown(', '.join(found.recordings))} ({found.seconds:.0f} s)"
    if found.kind == "forces":
        head = (
            f"Forces that the measured motion of {where} needs, in {target.title} and by the plant itself, and the end "
            "effector at the measured joints. RMS values. The difference contains that of the motion under the recorded "
            f"commands, in runs of {RUN:g} s. It may be {100.0 * SHARE:g} % of the RMS of the force or of the end effector "
            "about its mean, or the noise of the sensor."
        )
    else:
        head = (
            f"Free run of {where} from recorded commands, in {target.title} and by the plant itself; both begin at rest where "
            f"the recording begins. RMS values. The difference may be {100.0 * SHARE:g} % of the motion, the noise of the "
            "sensor, or the rounding of the format."
        )
    rows = [f"| signal | {target.title} | plant | sensor noise | difference | allowed |", "| --- |" + " ---: |" * 5]
    for row in found.rows:
        unit = unit_of(row.signal, units)
        cells = [shown(x, unit) for x in (row.export_error, row.plant_error, row.noise)]
        marks = "" if row.agrees else " **exceeded**"
        cells += [shown(row.difference, unit), shown(row.allowed, unit) + marks]
        rows.append(f"| {code(row.signal)} | {' | '.join(cells)} |")
    return [head + "\n", *rows, ""]


def shown(value: float, unit: str) -> str:
    """A figure with its unit; a difference by rounding is zero, what is not measured a dash."""
    return quantity(value if abs(value) > ROUNDING else 0.0, unit) if np.isfinite(value) else "–"


def unit_of(signal: str, units: Mapping[str, str]) -> str:
    """SI unit of a signal; where the dataset does not say, none of commands, metres of points and cylinders, else radians."""
    owner, quantity = split_signal(signal)
    if quantity == "command":
        return units.get(signal, "1")
    return units.get(signal) or ("m" if owner in ("ee", "tool") or quantity == "cylinder" else "rad")


def _uncertainty(plant: Plant, files: Sequence[str]) -> list[str]:
    if SAMPLES not in files:
        return ["The plant stores no uncertainty of its parameters.\n"]
    count = len(plant.uncertainty.places)
    return [f"`{SAMPLES}` holds joint draws of {count} parameters, `{RANGES}` their ranges. {WARNING}\n"]


def support_in(plant: Plant, target: Target, effect: Effect) -> Support:
    """How a target represents an effect of a plant; one of links needs their masses."""
    if effect.of_links and not any(moves_masses(plant.machine, actuation) for actuation in LINKED):
        return Support("not_representable", "it acts by the torque of links, and the machine describes none")
    return target.support(effect)


def lacking(plant: Plant, target: Target) -> list[str]:
    """Effects of a plant that the target cannot represent, ``name on target``."""
    missing = [e for e in plant.effects if support_in(plant, target, effect_named(e.name)).kind == "not_representable"]
    return [f"{e.name} on {e.target}" for e in missing] + [f"unnamed_residual on {r.target}" for r in plant.residuals]
