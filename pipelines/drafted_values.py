"""How often ``sysid start`` drafts the right values: generated machines, their logs, the drafted files beside the truth.

    .venv/bin/python pipelines/drafted_values.py --seeds 2000:2100

writes the tables of ``reports/drafted_values/``. Every machine is drafted twice: as ``--yes`` does it, and with every question
answered as its owner would. A value is right as drafted; or it is asked: wrong as proposed, right after the answer; or its axis
is left out with a reason; or it is wrong in silence.
"""

from __future__ import annotations

import argparse
import re
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from committed import markdown, write_tables
from drafted.machines import FACTORS, LENGTHS, Axis, Machine, generate
from sysid.datasets import ingest
from sysid.datasets.drafting import Description, Question, describe
from sysid.datasets.drafting.fields import Answers
from sysid.datasets.recipe import SignalMap, load_recipe
from sysid.errors import SysidError
from sysid.logs.inspection import FileSummary, inspect_file
from sysid.machine import Axis as DraftedAxis
from sysid.machine import load_machine
from sysid.units import si_factor

PAGE = Path(__file__).parents[1] / "reports" / "drafted_values" / "README.md"
#: Largest error of a gain; of neutral, span and stroke as a share of the range; of the rate; of an inertia.
GAIN, RANGE, RATE, INERTIA = 0.02, 0.01, 0.01, 0.1
Array = npt.NDArray[np.float64]
ACTUATIONS = {"valve": "velocity", "servo": "position", "force": "force"}
#: Value → what counts as right.
VALUES = {
    "columns": "command and motion of each axis are its columns",
    "no other axis": "nothing else is drafted as an axis",
    "rate": "within 1 %",
    "unit of the time": "the one of the file",
    "actuation": "velocity, position or force",
    "cylinder or joint": "what a valve moves",
    "unit of the motion": "the one of the file",
    "unit of the command": "of servos and forces",
    "neutral": "within 1 % of the range of the command",
    "span": "full command at most 2 % beyond the true one",
    "gain": "within 2 % of the steady speed at full command",
    "stroke or limits": "within 1 % of the range in the logs",
    "inertia": "within 10 %",
    "as ingested": "signals of the dataset version have the drafted range",
}
STATES = ("right", "asked", "left out", "wrong")
#: Begin of the reason for an axis that is not drafted.
LEFT_OUT = "left out: "
NOT_DRAFTED = "not drafted"


@dataclass(frozen=True)
class Result:
    """One machine: (value, axis) → one of :data:`STATES`, with what was found; ``questions``: the keys that were asked."""

    seed: int
    kind: str
    values: Mapping[tuple[str, str], tuple[str, str]]
    questions: tuple[str, ...]


def result_of(seed: int, work: Path) -> Result:
    """Draft the machine of ``seed`` from logs in ``work``, and compare with the truth."""
    folder = work / "logs"
    machine = generate(folder, seed)
    files = [inspect_file(path) for path in sorted(folder.rglob("*")) if path.is_file()]
    first = answered = _drafted(files, folder, {})
    given, asked = dict[str, str](), list[str]()
    while not isinstance(answered, str) and answered.questions:  # an answer may settle or raise another question
        asked.append(answered.questions[0].key)
        given |= answers_of(answered.questions[0], machine, _names(answered))
        answered = _drafted(files, folder, given)
    proposed = _compared(first, folder, machine)
    after = _compared(answered, folder, machine) if asked else proposed
    values = {key: _state(proposed.get(key, NOT_DRAFTED), after.get(key, NOT_DRAFTED)) for key in {**proposed, **after}}
    return Result(seed, machine.kind, values, tuple(asked))


def _state(proposed: str, after: str) -> tuple[str, str]:
    """State of a value from what is wrong with it as proposed and after the answers; empty: nothing."""
    if not proposed and not after:
        return "right", ""
    if not after:
        return "asked", proposed
    return ("left out" if after.startswith(LEFT_OUT) or after == NOT_DRAFTED else "wrong"), after


def _drafted(files: Sequence[FileSummary], folder: Path, given: Mapping[str, str]) -> Description | str:
    try:
        return describe(files, folder, "m", Answers(given))
    except SysidError as error:
        return f"{LEFT_OUT}{error}"


def answers_of(question: Question, machine: Machine, axes: Mapping[str, str]) -> dict[str, str]:
    """What the owner of the machine answers; where one answer is not right for all axes, of single axes too.

    Args:
        axes: column of the command → the drafted name of its axis.
    """
    named = [axis for axis in machine.axes if f"{axis.motion} " in f"{question.why} " or axis.command in question.why]
    own = list(machine.axes) if " more" in question.why or not named else named
    quantity = question.key.rpartition(".")[2]
    if quantity == "time_unit":
        return {question.key: machine.time_unit}
    if quantity == "measured":
        return {question.key: "yes"}
    if quantity == "force_scale":
        return {question.key: "1"}  # columns without a unit are in SI
    right: Callable[[Axis], str] = {
        "actuation": lambda axis: ACTUATIONS[axis.kind],
        "drives": lambda axis: axis.drives,
        "neutral": lambda axis: f"{axis.zero:g}",
    }.get(quantity, lambda axis: axis.unit)
    if quantity == "neutral":
        own = [axis for axis in machine.axes if axes[axis.command] == question.key.removesuffix(".neutral")]
    usual = Counter(right(axis) for axis in own if not question.choices or right(axis) in question.choices).most_common(1)
    if not usual:
        return {question.key: question.proposal}
    found = {question.key: usual[0][0]}
    if question.key in ("drives", "position_unit", "actuation"):
        key = question.key.removeprefix("position_")
        found |= {f"{axes[axis.command]}.{key}": right(axis) for axis in own if right(axis) != usual[0][0]}
    return found


def _compared(found: Description | str, folder: Path, machine: Machine) -> dict[tuple[str, str], str]:
    """(value, axis) → what is wrong, empty where it is right."""
    if isinstance(found, str):
        return {("columns", axis.name): found for axis in machine.axes}
    (folder / "machine.toml").write_text(found.machine, "utf-8")
    (folder / "recipe.toml").write_text(found.recipe, "utf-8")
    try:
        drafted, recipe = load_machine(folder / "machine.toml"), load_recipe(folder / "recipe.toml")
    except SysidError as error:
        return {("columns", axis.name): str(error) for axis in machine.axes}
    signals = {name: signal for stream in recipe.streams for name, signal in stream.signals.items()}
    units = {stream.time_unit for stream in recipe.streams}
    wrong: dict[tuple[str, str], str] = {}
    rate = "" if abs(drafted.rate_hz / machine.rate_hz - 1.0) <= RATE else f"{drafted.rate_hz} for {machine.rate_hz}"
    wrong["rate", ""] = rate
    wrong["unit of the time", ""] = "" if units <= {None, machine.time_unit} else f"{units} for {machine.time_unit}"
    by_command = {signals[f"{axis.name}.command"].field: axis for axis in drafted.axes}
    own = {axis.command: next((by_command[c] for c in by_command if _plain(c) == axis.command), None) for axis in machine.axes}
    others = [axis.name for axis in drafted.axes if axis not in own.values()]
    wrong["no other axis", ""] = ", ".join(others)
    for axis in machine.axes:
        its = own[axis.command]
        motion = signals[its.driven].field if its is not None else ""
        if its is None or _plain(motion) != axis.motion:
            beside = next((line for line in found.left_out if axis.motion in line or axis.command in line), "")
            said = f"{LEFT_OUT}{beside}" if its is None and beside else f"{axis.command} with {motion or 'nothing'}"
            wrong["columns", axis.name] = said
            continue
        wrong["columns", axis.name] = ""
        command = signals[f"{its.name}.command"]
        wrong |= {(name, axis.name): text for name, text in _of_axis(axis, its, command, signals[its.driven], machine.ends)}
    return wrong | _as_ingested(folder, machine, own)


def _names(found: Description) -> dict[str, str]:
    """Column of a command → the name of its axis in the drafted recipe."""
    entries = re.findall(r'^"?(.+?)\.command"? = \{.*?field = "(.+?)"', found.recipe, re.MULTILINE)
    return {_plain(field): name for name, field in entries}


def _plain(field: str) -> str:
    """The name of a column without its unit."""
    for unit in (*FACTORS, "%", "pct", "us", "V", "N", "Nm", "N·m"):
        for ending in (f" [{unit}]", f" ({unit})", f"_{unit}"):
            if field.endswith(ending):
                return field.removesuffix(ending)
    return field


def _of_axis(
    axis: Axis, its: DraftedAxis, command: SignalMap, motion: SignalMap, ends: Mapping[str, tuple[float, float]]
) -> Iterator[tuple[str, str]]:
    """Value → what is wrong of an axis whose columns are right."""
    right = its.actuation == ACTUATIONS[axis.kind]
    yield "actuation", "" if right else f"{its.actuation} for {ACTUATIONS[axis.kind]}"
    if not right:
        return
    if axis.kind == "valve":
        yield "cylinder or joint", "" if its.drives == axis.drives else f"{its.drives} for {axis.drives}"
    factor = si_of(motion)
    right = abs(factor / FACTORS[axis.unit] - 1.0) < 1e-3 and _kind_of(motion) == (axis.unit in LENGTHS)
    yield "unit of the motion", "" if right else f"{motion.unit} {motion.span:.4g} for {axis.unit}"
    if axis.kind == "servo":
        right = abs(si_of(command) / FACTORS[axis.command_unit] - 1.0) < 1e-3
        yield "unit of the command", "" if right else f"{command.unit} {command.span:.4g} for {axis.command_unit}"
    if axis.kind == "force":
        right = (command.unit or "").replace("Nm", "N·m") == axis.command_unit
        yield "unit of the command", "" if right else f"{command.unit} for {axis.command_unit}"
        close = its.inertia is not None and abs(its.inertia / axis.inertia - 1.0) <= INERTIA
        yield "inertia", "" if close else f"{its.inertia} for {axis.inertia:.4g}"
    if axis.kind == "valve":
        zero, full = command.zero, command.zero + command.sign * command.span / command.scale
        yield "neutral", "" if abs(zero - axis.zero) <= RANGE * 2.0 * axis.span else f"{zero:.5g} for {axis.zero:.5g}"
        whole = abs(full - axis.zero) <= (1.0 + 2.0 * RANGE) * axis.span
        yield "span", "" if whole else f"{command.span:.4g} for {axis.span:.4g}"
        speed = axis.speed_at(full)
        yield "gain", "" if abs(its.gain - speed) <= GAIN * abs(speed) else f"{its.gain:.4g} for {speed:.4g} at {full:.4g}"
    low, high = ends[axis.name]
    found = its.range
    close = found is not None and max(abs(found[0] - low), abs(found[1] - high)) <= RANGE * (high - low)
    yield "stroke or limits", "" if close else f"{found} for {low:.4g} … {high:.4g}"


def si_of(signal: SignalMap) -> float:
    return signal.scale / signal.span * (si_factor(signal.unit)[0] if signal.unit else 1.0)


def _kind_of(signal: SignalMap) -> bool:
    """Whether it is a length."""
    return signal.unit is not None and si_factor(signal.unit)[1] == "m"


def _as_ingested(folder: Path, machine: Machine, own: Mapping[str, DraftedAxis | None]) -> dict[tuple[str, str], str]:
    """What is wrong with the ranges of the signals in the dataset version, beside those of the description."""
    drafted = {axis.name: its for axis in machine.axes if (its := own[axis.command]) is not None}
    with tempfile.TemporaryDirectory() as workspace:
        try:
            dataset = ingest([folder], Path(workspace), recipe=folder / "recipe.toml")
        except SysidError as error:
            return {("as ingested", name): str(error) for name in drafted}
        return {
            ("as ingested", name): _out_of_range(
                its, *(np.concatenate([r.values(signal) for r in dataset.recordings if signal in r.signals] or [np.empty(0)])
                       for signal in (f"{its.name}.command", its.driven))
            )
            for name, its in drafted.items()
        }  # fmt: skip


def _out_of_range(its: DraftedAxis, command: Array, motion: Array) -> str:
    command, motion = command[np.isfinite(command)], motion[np.isfinite(motion)]
    if not len(command) or not len(motion) or its.range is None:
        return "no samples"
    most = float(np.abs(command).max())
    if its.actuation == "velocity" and not 0.5 < most < 1.1:
        return f"command up to {most:.4g}"
    low, high = its.range
    slack = 0.05 * (high - low)
    if its.actuation != "force" and not (motion.min() >= low - slack and motion.max() <= high + slack):
        return f"motion {motion.min():.4g} … {motion.max():.4g} for {low:.4g} … {high:.4g}"
    return ""


def counted(results: Sequence[Result]) -> dict[str, Counter[str]]:
    """Value → number of each state."""
    found: dict[str, Counter[str]] = {value: Counter() for value in VALUES}
    for result in results:
        for (value, _), (state, _) in result.values.items():
            found[value][state] += 1
    return found


def tables(results: Sequence[Result], seeds: str) -> str:
    """The tables of the page."""
    counts = counted(results)
    whole = sum(counts.values(), Counter[str]())
    rows = [
        [value, right, *(str(counts[value][state]) for state in STATES)]
        for value, right in VALUES.items()
        if counts[value].total()
    ]
    rows.append(["**all**", "", *(f"{whole[state]} ({whole[state] / whole.total():.1%})" for state in STATES)])
    asked = [len(result.questions) for result in results]
    kinds = Counter(result.kind for result in results)
    text = f"{len(results)} machines ({', '.join(f'{kinds[kind]} {kind}' for kind in ACTUATIONS)}), seeds {seeds}. "
    text += (
        f"Questions a machine: {np.mean(asked):.2f} on average, {max(asked)} at most; {asked.count(0)} machines without one. "
    )
    silent = sum(any(state == "wrong" for state, _ in result.values.values()) for result in results)
    text += f"Machines with a value that is wrong in silence: {silent}."
    table = markdown(["value", "right is", "right", "asked", "left out, said", "wrong in silence"], rows, "ll")
    wrong = [
        f"seed {result.seed}, {axis or 'machine'}: {value} {text}"
        for result in results
        for (value, axis), (state, text) in result.values.items()
        if state == "wrong"
    ]
    return "\n\n".join([text, table, *(["Wrong in silence: " + "; ".join(wrong) + "."] if wrong else [])])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="2000:2100", metavar="FIRST:END")
    parser.add_argument("--print", action="store_true", help="print the tables, and change no page")
    options = parser.parse_args()
    first, end = map(int, options.seeds.split(":"))
    results = []
    for seed in range(first, end):
        with tempfile.TemporaryDirectory() as work:
            results.append(result_of(seed, Path(work)))
        faults = [
            f"  {state}: {value} {axis}: {text[:200]}" for (value, axis), (state, text) in results[-1].values.items() if text
        ]
        print("\n".join([f"{seed} {results[-1].kind} {' '.join(results[-1].questions)}", *faults]), flush=True)
    text = tables(results, options.seeds)
    print(text)
    if not options.print:
        write_tables(PAGE, text, "pipelines/drafted_values.py")


if __name__ == "__main__":
    main()
