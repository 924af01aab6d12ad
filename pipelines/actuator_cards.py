"""Cards of actuators from measured data: the gap workflow on each set, the plant of the actuators alone, its replay in MuJoCo.

    .venv/bin/python pipelines/actuator_cards.py DATA_FOLDER [--only NAME] [--publish]

DATA_FOLDER has a folder for each set with its raw files (their sources: ``datasets/*/README.md``). ``--publish`` writes the
cards into ``sysid/actuators/cards`` and their table into ``docs/actuators.md``; without it they are written to the workspace.
Held-out recordings are used twice: for the errors, and alone, to estimate the values again.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import emps
import rc_excavator
import ur10e
import xl330
from committed import ROOT, markdown, provenance, write_result, write_tables
from sysid.actuators.card import FOLDER, ActuatorCard, CardReplay, card_from
from sysid.actuators.export import EXPRESSED
from sysid.actuators.make import card_of, repetitions
from sysid.actuators.words import data_text, error_text, repetition_text
from sysid.cli.output import PipelineProgress, Printer
from sysid.config import read_toml
from sysid.datasets import Dataset, ingest
from sysid.datasets.recipe import Splits
from sysid.datasets.recording import Role
from sysid.datasets.splits import split
from sysid.effects import effect_named
from sysid.errors import SettingsError, nearest
from sysid.export.export import Export, export_plant, target_named
from sysid.gap import GapResult, find_gap
from sysid.gap.result import NearMissResult, WrittenEffect
from sysid.logs import ReadOptions, reader_named
from sysid.machine import KnownEffect
from sysid.machine.description import ServoLaw
from sysid.plant import Plant, compile_plant
from sysid.plant.force import force_inputs
from sysid.reports.result_figures import parameters_of
from sysid.signals import axis_signal, split_signal
from sysid.workspace import Workspace, open_workspace

CONTENT, PAGE = ROOT / "datasets", ROOT / "docs" / "actuators.md"
#: Gain of the position loop of the XL330 whose values its card states; the servo leaves the factory with it.
XL330_GAIN = 400
TWICE = "a free run, which integrates errors of the force twice"
#: Duty of an XL330 that is not limited [1/885].
UNLIMITED = 880


@dataclass(frozen=True)
class Identified:
    """The result of the workflow on one set.

    Args:
        again: recordings that no fit of ``result`` has used → result of them alone.
        conditions: those that the logs state.
        loops: position loops of servos, as the logs state them.
        beside: what other data show of the same actuator.
    """

    dataset: Dataset
    result: GapResult
    again: dict[str, GapResult]
    conditions: tuple[str, ...] = ()
    loops: dict[str, ServoLaw] | None = None
    beside: tuple[str, ...] = ()


@dataclass(frozen=True)
class Set:
    """A set of measured data, and what its card says of it."""

    title: str
    folder: str
    recipe: str
    source: str
    licence: str
    conditions: tuple[str, ...]
    default: str
    identify: Callable[[Path, Workspace], Identified]
    published: str = ""


def identify_emps(raw: Path, place: Workspace) -> Identified:
    dataset = ingest(raw, place.location, recipe=emps.RECIPE)
    result = find_gap(dataset, place.plant(dataset), place.models, add=True)
    return Identified(dataset, result, alone(dataset, place, "pulses"))


def identify_xl330(raw: Path, place: Workspace) -> Identified:
    logs = xl330.write_torques(raw, place.folder / "xl330" / "torque")
    motor = ingest(logs, place.location, machine=xl330.CONTENT / "torque.toml")
    whole = xl330.all_logs(motor)
    result = find_gap(whole, place.plant(whole), place.models, add=True)
    # The fourth gain, one log to fit, one to select, one to prove.
    parts = [part for part in xl330.log_by_log(motor) if part.recordings[0].name.endswith("-400")]
    again = {part.recordings[0].name: find_gap(part, place.plant(part)) for part in parts}
    slope, volts = duty_law(raw)
    kp = xl330.KT / xl330.RESISTANCE * volts * slope * XL330_GAIN / xl330.FULL_DUTY
    loop = ServoLaw(kp=round(kp, 4), force_limit=round(xl330.KT / xl330.RESISTANCE * volts, 4))
    stated = (
        f"Position P gain {XL330_GAIN}: duty/885 = {slope:.3f}·gain/885 per rad of error, as the logs of all gains show, at "
        f"{volts:.2f} V; kp of another gain is in proportion",
    )
    return Identified(whole, result, again, stated, {"arm": loop})


def duty_law(raw: Path) -> tuple[float, float]:
    """Duty per error and gain [1/rad] by least squares where the motor is not limited, and the mean supply [V]."""
    ratios, volts = [], []
    for name, file in read_toml(xl330.CONTENT / "recipe.toml")["recordings"]["files"].items():
        (log,) = reader_named("json", xl330.CONTENT).read(raw / file, ReadOptions(time="timestamp"))
        duty = (log.columns["load"] + 2**15) % 2**16 - 2**15
        error = log.columns["goal_position"] - log.columns["position"]
        free = np.abs(duty) < UNLIMITED
        ratios.append(float(error[free] @ duty[free] / (error[free] @ error[free])) / float(name.rsplit("-", 1)[1]))
        volts.append(float(np.mean(log.columns["input_volts"])))
    return float(np.median(ratios)), float(np.mean(volts))


def identify_so101(raw: Path, place: Workspace) -> Identified:
    dataset = ingest(raw, place.location, recipe=CONTENT / "so101" / "recipe.toml")
    result = find_gap(dataset, place.plant(dataset), place.models, add=True)
    return Identified(dataset, result, alone(dataset, place), beside=(backlash_on_a_stand(raw.parent, place),))


def backlash_on_a_stand(data: Path, place: Workspace) -> str:
    """The backlash of one STS3215 that holds a lever between two rubber bands (``datasets/servo_backlash``)."""
    log, recipe = data / "servo_backlash" / "single.csv", CONTENT / "servo_backlash" / "recipe.toml"
    dataset = ingest(log, place.location, recipe=recipe, name="backlash-single")
    found = find_gap(dataset, place.plant(dataset), world=False)
    where = "One STS3215 under an external pull (datasets/servo_backlash, single.csv; published 0.8 to 0.9°)"
    tested: list[WrittenEffect | NearMissResult] = [*found.written, *found.near_misses]
    for item in tested:
        if item.name == "backlash":
            (figure,) = parameters_of(item.name, item.target, item.parameters, dataset.machine, dataset.units, item.interval95)
            named = item.name in {effect.name for effect in found.effects}
            return f"{where}: backlash {figure.sentence}, {'named' if named else 'not named'}"
    return f"{where}: the workflow does not test a backlash there"


def identify_ur10e(raw: Path, place: Workspace) -> Identified:
    site = ur10e.prepare(raw, place.folder / "ur10e" / "site")
    dataset = ingest(site / "logs", place.location, recipe=site / "ur10e.toml")
    result = find_gap(dataset, place.plant(dataset), place.models, add=True, world=False)
    return Identified(dataset, result, alone(dataset, place, "points"))


def identify_pendulum(raw: Path, place: Workspace) -> Identified:
    dataset = ingest(raw, place.location, recipe=CONTENT / "double_pendulum" / "recipe.toml")
    result = find_gap(dataset, place.plant(dataset), place.models, add=True, world=False)
    return Identified(dataset, result, swapped(dataset, place))


def identify_excavator(raw: Path, place: Workspace) -> Identified:
    dataset = ingest(raw, place.location, recipe=rc_excavator.RECIPE)
    result = find_gap(dataset, place.plant(dataset), place.models, add=True)
    return Identified(dataset, result, alone(dataset, place, "steps"))


def alone(dataset: Dataset, place: Workspace, name: str = "") -> dict[str, GapResult]:
    """The result of the held-out recordings whose names begin with ``name``, shared out again to fit, select and prove."""
    held = [recording for recording in dataset.with_role("held_out") if recording.name.startswith(name)]
    recordings, roles = split(held, Splits(), dataset.reference, dataset.machine)
    part = replace(dataset, recordings=recordings, splits=roles)
    return {", ".join(recording.name for recording in held): find_gap(part, place.plant(part), world=False)}


def swapped(dataset: Dataset, place: Workspace) -> dict[str, GapResult]:
    """The result with the held-out recordings, which are too short to be cut, in the place of those of the fit."""
    roles: dict[Role, Role] = {"fit": "held_out", "select": "select", "held_out": "fit"}
    part = replace(dataset, splits={name: roles[role] for name, role in dataset.splits.items()})
    held = [recording.name for recording in dataset.with_role("held_out")]
    return {f"{', '.join(held)} in the place of the fit": find_gap(part, place.plant(part), world=False)}


SETS = {
    "dynamixel-xl330": Set(
        "Dynamixel XL330-M288 servo", "bam_xl330", "datasets/xl330/recipe.toml, torque.toml",
        "github.com/Rhoban/bam (Better Actuator Models)", "Apache-2.0",
        ("load: a pendulum of 0.49 kg at 0.1 m", "position control with gains 100, 200, 400 and 800, supply 7.4 V",
         "torque from the duty by the authors' kt 0.3867 N·m/A and R 4.017 Ω; viscous friction contains the motor's own brake"),
        "the motor without friction and without a rotor", identify_xl330,
        "viscous friction 0.0409 N·m·s/rad with the motor's own brake, dry friction 0.0128 N·m, rotor 0.00181 kg·m² (m1, from "
        "more logs)",
    ),
    "feetech-sts3215": Set(
        "Feetech STS3215 servo, six joints of an SO-101 arm", "sage_so101", "datasets/so101/recipe.toml",
        "github.com/isaac-sim2real/sage", "Apache-2.0",
        ("load: the links of the arm, whose masses do not come with the logs", "gains and supply: not stated"),
        "the ideal servo, at its setpoint in the same row of the log", identify_so101,
    ),
    "ur10e-joints": Set(
        "Joints of a UR10e arm", "ur10e_arm", "datasets/ur10e/recipe.toml",
        "github.com/shamilmamedov/dynamic_calibration, commit 11af40e7", "none stated: the card has no file of it",
        ("torque from the motor currents by the authors' constants", "load: the arm without a payload",
         "temperature: not stated"),
        "the masses of the URDF without friction", identify_ur10e,
    ),
    "emps-drive": Set(
        "Ball-screw drive of the EMPS bench", "emps", "datasets/emps/recipe.toml",
        "github.com/forgi86/sysid-neural-continuous; Janot, Gautier and Brunot 2019", "none stated for the data",
        ("force from the controller output by 35.15 N/V", "moving mass 95.1 kg; temperature: not stated"),
        "the moving mass without friction", identify_emps,
        "dry friction 20.1 and 20.6 N, viscous friction 167 and 240 N·s/m, by direction",
    ),
    "ak80-6-drives": Set(
        "Quasi-direct drives (T-Motor AK80-6) of a double pendulum", "double_pendulum", "datasets/double_pendulum/recipe.toml",
        "github.com/dfki-ric-underactuated-lab/double_pendulum, design A.0", "BSD-3-Clause",
        ("torque: the command to the motors, in which the friction compensation of one recording is contained",
         "load: links of 0.3 and 0.2 m with the authors' masses", "temperature: not stated"),
        "the authors' masses without friction and rotors", identify_pendulum,
        "0.093 and 0.078 N·m times arctan(100·speed), so dry friction 0.146 N·m of the shoulder and 0.123 N·m of the elbow; "
        "rotors 0.00276 kg·m² at the joint",
    ),
    "rc-excavator-valves": Set(
        "Hydraulic valves and cylinders of an RC excavator", "rc_excavator", "datasets/rc_excavator/recipe.toml",
        "github.com/mitchallain/BeagleBone-excavator", "none stated",
        ("command: PWM duty from neutral over its half span", "load: the links of the machine; pressure and oil: not stated"),
        "speed in proportion to the command", identify_excavator,
    ),
}  # fmt: skip


def main(data: Path, workspace: Path, only: str | None = None, publish: bool = False) -> list[ActuatorCard]:
    """Make the cards and return them."""
    if only is not None and only not in SETS:
        raise SettingsError("--only", f"no card {only!r}", nearest(only, SETS))
    out = Printer()
    station, target = PipelineProgress(out), FOLDER if publish else workspace / "cards"
    target.mkdir(parents=True, exist_ok=True)
    cards, head = [], provenance("", None, ("mujoco-core",))  # before any card is replaced
    for name in [only] if only is not None else SETS:
        with station(name):
            cards.append(made(name, SETS[name], data, open_workspace(workspace / name), head))
        path = target / f"{name}.json"
        write_result(path, cards[-1].to_json())
        out.line(f"{path}: {error_text(cards[-1])}")
    if publish:
        write_tables(PAGE, table(), "pipelines/actuator_cards.py")
    return cards


def made(name: str, about: Set, data: Path, place: Workspace, head: dict[str, Any]) -> ActuatorCard:
    """The card of one set; ``head``: commit, versions and date."""
    found = about.identify(data / about.folder, place)
    repaired = place.plant(found.dataset, found.result.plant_after)
    head = {key: value for key, value in head.items() if key not in ("schema", "seed")}
    head["command"] = f"pipelines/actuator_cards.py DATA_FOLDER --only {name}"
    lineage = {"plant": place.models.find(found.result.plant_after).digest, "verdict": found.result.verdict}

    published = (f"Published by the authors of the data: {about.published}",) if about.published else ()

    def card(again: Sequence[Any] = (), replays: Sequence[CardReplay] = ()) -> ActuatorCard:
        return card_of(
            name, about.title, found.dataset, found.result, repaired, source=about.source, licence=about.licence,
            recipe=about.recipe, conditions=(*about.conditions, *found.conditions), default=about.default,
            made=head | lineage, loops=found.loops or {}, beside=(*published, *found.beside), repeated=again, replays=replays,
        )  # fmt: skip

    first = card()
    again = [item for text, result in found.again.items() for item in repetitions(first.values, result, text)]
    whole = card(again, list(replays_of(first, repaired, found.dataset)))
    return card_from(json.loads(json.dumps(whole.to_json())), name)  # as it is read from its file


def replays_of(card: ActuatorCard, repaired: Plant, dataset: Dataset) -> Iterator[CardReplay]:
    """The export of the card, and its defaults, in MuJoCo on the held-out recordings."""
    linked = dataset.machine.urdf is not None
    exported = exported_to_mujoco(repaired if linked else card.model, dataset)
    errors = {row.signal: row.plant_error for row in exported.replay.rows} if exported.replay is not None else {}
    missing = "with the links that the actuators move" if linked else ""
    yield worst("the whole export", card, exported, errors, missing)
    if all(axis.actuation == "force" for axis in dataset.machine.axes):
        plain = expressed(repaired)
        yield worst("its defaults alone", card, exported_to_mujoco(plain, dataset), errors, missing or TWICE)
        if not linked:  # with links, forces are what was replayed
            yield from force_ratios(card, repaired, plain, dataset)
    else:
        why = "the recordings do not show the stiffness that a servo of MuJoCo needs"
        yield CardReplay("its defaults alone", why=why if dataset.machine.axes[0].follows_positions else
                         "MuJoCo has no actuator whose command is a flow")  # fmt: skip


def force_ratios(card: ActuatorCard, whole: Plant, plain: Plant, dataset: Dataset) -> Iterator[CardReplay]:
    """The defaults by the force that they need for the measured motion, by the equations of the plant."""
    for axis in dataset.machine.axes:
        inputs = [force_inputs(recording, axis) for recording in dataset.with_role("held_out")]
        errors = []
        for plant in (plain, whole):
            model = compile_plant(plant)
            away = [part.model_force(model, model.theta[None], axis.name)[0] - part.force for part in inputs]
            errors.append(float(np.sqrt(np.nanmean(np.concatenate(away) ** 2))))
        signal = axis_signal(axis.name, "command")
        yield CardReplay("its defaults alone", signal, errors[0] / errors[1], "forces at the measured motion, by the equations")


def exported_to_mujoco(plant: Plant, dataset: Dataset) -> Export:
    with tempfile.TemporaryDirectory() as folder:
        return export_plant(plant, dataset, target_named("mjcf"), Path(folder) / "mjcf", force=True)


def worst(what: str, card: ActuatorCard, found: Export, errors: dict[str, float], why: str) -> CardReplay:
    """The measured signal of the actuators whose error grows most by the export."""
    assert found.replay is not None
    rows = [row for row in found.replay.rows if split_signal(row.signal)[0] in card.axes and np.isfinite(row.export_error)]
    ratios = {row.signal: row.export_error / errors[row.signal] for row in rows}
    signal = max(ratios, key=lambda name: ratios[name])
    return CardReplay(what, signal, ratios[signal], why)


def expressed(plant: Plant) -> Plant:
    """The plant with the effects of its actuators that defaults express, friction as the mean of both directions."""
    for item in plant.effects:
        effect, sides = effect_named(item.name), ("positive", "negative")
        if effect.stage not in ("command", "force") or item.name == "force_constant_error":
            continue
        if item.name not in EXPRESSED:
            plant = plant.without_effect(item.name, item.target, item.side)
        elif set(item.parameters) == set(sides):
            mean = float(np.mean([np.asarray(item.parameters[side]) for side in sides]))
            plant = plant.with_effect(KnownEffect(item.name, item.target, {effect.forms[0].names[0]: mean}))
    return plant


def table() -> str:
    """All cards of the package in Markdown."""
    rows = []
    for path in sorted(FOLDER.glob("*.json")):
        card = card_from(json.loads(path.read_text("utf-8")), path.name)
        named = dict.fromkeys(effect_named(item.name).title.lower() for item in card.values if item.kind == "named")
        replay = ", ".join("–" if item.ratio is None else f"{item.ratio:.2f}" for item in card.replays)
        again = repetition_text(card) if card.repeated else "–"
        rows.append(
            [f"`{card.name}`", card.title, data_text(card.data), ", ".join(named) or "–", error_text(card), again, replay]
        )
    header = ["card", "what", "data", "named", "held-out error: default → card", "values from other recordings", "replay"]
    return markdown(header, rows, "lllllll")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder with a folder for each set")
    parser.add_argument("--only", default=None, metavar="NAME", help=", ".join(SETS))
    parser.add_argument("--publish", action="store_true")
    parser.add_argument("--workspace", type=Path, default=Path("workspace") / "actuators")
    given = parser.parse_args()
    main(given.data, given.workspace, given.only, given.publish)
