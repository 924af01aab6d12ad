"""Plant → the functions of a batch of machines, recorded from the kernels that move the plant itself.

The complete state of a machine is that of :class:`sysid.plant.stepper.Stepper`: the memories of its axes, their loads, and the
swing of the tool. Only those numbers are kept that a machine with the effects of this plant reads, and not what follows from
its parameters alone, so that a change of the parameters acts at once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from sysid.effects import gripper_sway, input_delay, joint_compliance
from sysid.export.torchscript.graph import Graph, Node, Value, is_unset
from sysid.export.torchscript.kernels import Kernels, Memory
from sysid.export.torchscript.source import Function, module, source
from sysid.plant import Plant, chain, compile_plant, sensing, stepper, trig
from sysid.plant.layout import AT, AXIS_WIDTH, STATE, axis_memory, neutral_vector, signal_place, signals_of
from sysid.plant.machine_arrays import HIGH, KIND, LOW, POSITION, TABLE_LOW, TABLE_STEP
from sysid.plant.machine_run import advance, observe
from sysid.plant.pose import SCRATCH, pose

Array = npt.NDArray[np.float64]
Values = Sequence[Value]


@dataclass(frozen=True)
class Recording:
    """What a function leaves: the complete ``state``, and its ``results``."""

    state: list[Value]
    results: tuple[list[Value], ...]


class Equations:
    """The functions of a plant.

    Args:
        columns: index in the plant's vector → column of the parameters of the batch.
        longest: axis → inputs that its longest delay needs.
    """

    def __init__(self, plant: Plant, rate_hz: float, columns: Mapping[int, int], longest: Mapping[int, int]) -> None:
        self.model, self.dt, self.longest = compile_plant(plant), 1.0 / rate_hz, longest
        self.arrays, self.count = self.model.arrays, self.model.axes
        self.size = axis_memory(self.dt)
        self.names, self.linked = plant.machine.axis_names, [name in plant.linkages for name in plant.machine.axis_names]
        self.drives = [axis.drives for axis in plant.machine.axes]
        self.graph = Graph()
        vector = self.model.theta
        self.theta: list[Value] = [float(x) for x in neutral_vector(self.count)]
        for index, column in columns.items():
            self.theta[index] = self.graph.input("theta", column, float(vector[index]))
        self.loads = range(self.count * self.size, self.count * (self.size + 1))
        self.width = self.loads.stop + gripper_sway.MEMORY
        self.rings = {i * self.size + STATE.input_delay: longest[i] for i in range(self.count) if i in longest}
        places = (i * self.size + k for i in range(self.count) for k in (STATE.position, STATE.speed))
        self.given = {*places, *self.loads}

    # Functions: each takes the complete state and the columns of its inputs.

    def start(self, k: Kernels, s: Memory, load: Memory, swing: Memory) -> tuple[list[Value], ...]:
        """Joints without sag, drives and speeds → the state at rest there."""
        straight, drives, speeds = (k.memory(self.inputs(name)) for name in ("joints", "drives", "speeds"))
        axes = self.arrays.axes
        drives.items = [k.graph("min", k.graph("max", x, axes[i, LOW]), axes[i, HIGH]) for i, x in enumerate(drives.items)]
        k(stepper._begin_lane, k.memory(self.theta), self.arrays, s, drives, speeds, straight, self.dt)
        load.items = [0.0] * self.count
        return ()

    def place(self, k: Kernels, s: Memory, load: Memory, swing: Memory) -> tuple[list[Value], ...]:
        """Drive, joints, structure, load (A,), end effector and tool (3,) of the state."""
        p, tip, tool = k.memory(self.theta), k.memory([math.nan] * 3), k.memory([math.nan] * 3)
        drive, joints, structure = (k.memory([math.nan] * self.count) for _ in range(3))
        k(observe, p, self.arrays, s, load, self.scratch(k), drive, joints, structure, tip, None, None)
        k(gripper_sway.step, *tip.items, p, self.arrays.tool, swing, 0, self.dt, tool)
        return drive.items, joints.items, structure.items, load.items, tip.items, tool.items

    def hold(self, k: Kernels, s: Memory, load: Memory, swing: Memory) -> tuple[list[Value], ...]:
        """The commands were held for a long time; that of a position axis is its position."""
        commands = k.memory(self.inputs("commands"))
        for i in range(self.count):
            if self.arrays.axes[i, KIND] == POSITION:
                commands.items[i] = s.items[i * self.size + STATE.position]
        k(stepper._hold_command, k.memory(self.theta), self.arrays, s, load, commands, 0.0, self.dt)
        return ()

    def step(self, k: Kernels, s: Memory, load: Memory, swing: Memory) -> tuple[list[Value], ...]:
        """One step with the commands; the results of :meth:`place` after it."""
        demands, commands = k.memory([math.nan] * self.count), k.memory(self.inputs("commands"))
        k(advance, k.memory(self.theta), self.arrays, s, load, demands, None, commands, self.dt, None, None)
        return self.place(k, s, load, swing)

    def bend(self, k: Kernels, s: Memory, load: Memory, swing: Memory) -> tuple[list[Value], ...]:
        """Joints without sag and their loads → the loads of the deflected posture."""
        p, before, straight = k.memory(self.theta), self.inputs("load"), self.inputs("joints")
        q = []
        for i in range(self.count):
            b = i * AXIS_WIDTH
            x = k.graph("add", straight[i], self.theta[b + AT.joint_offset])
            q.append(k(joint_compliance.step, x, p, b + AT.joint_compliance_structure, before[i]))
        found = k.memory([0.0] * self.count)
        k(pose, k.memory(q), p, self.arrays.links, self.arrays.base, self.scratch(k), k.memory([0.0] * 3), found)
        return (found.items,)

    def stretch(self, k: Kernels, s: Memory, load: Memory, swing: Memory) -> tuple[list[Value], ...]:
        """Joints at their sensors and their loads → joints without the sag of their drives, and the drives."""
        straight, drives = [], []
        for i, (joint, weight) in enumerate(zip(self.inputs("joints"), self.inputs("load"), strict=True)):
            sag = k.graph("mul", self.theta[i * AXIS_WIDTH + AT.joint_compliance_drive], weight)
            straight.append(k.graph("add", joint, sag))
            table = i, *(float(self.arrays.axes[i, column]) for column in (TABLE_LOW, TABLE_STEP))
            drives.append(k.graph("displaced", straight[i], *table) if self.linked[i] else straight[i])
        return straight, drives

    def read(self, k: Kernels, s: Memory, load: Memory, swing: Memory) -> tuple[list[Value], ...]:
        """Drive, joints, end effector and tool → :attr:`signals` as their sensors read them."""
        p, found = k.memory(self.theta), []
        for signal, (group, column) in self.signals.items():
            at = signal_place(self.names, signal)
            found.append(k(sensing.reading, k.graph.input(group, column), p, at))
        return (found,)

    @property
    def signals(self) -> dict[str, tuple[str, int]]:
        """Signals that a sensor may read → their input and column."""
        found = {}
        for signal in signals_of(self.names):
            owner, kind = signal.split(".")
            if owner in ("ee", "tool"):
                if self.arrays.posed:
                    found[signal] = owner, "xyz".index(kind)
            elif kind in ("joint", self.drives[self.names.index(owner)]):
                found[signal] = "joints" if kind == "joint" else "drive", self.names.index(owner)
        return found

    def inputs(self, name: str) -> list[Value]:
        return [self.graph.input(name, i) for i in range(self.count)]

    def scratch(self, k: Kernels) -> Memory:
        return k.memory([math.nan] * (len(self.arrays.links) * SCRATCH), SCRATCH)

    def record(self, function: Any, entry: Values) -> Recording:
        """Follow a function from a complete state."""
        kernels = Kernels(self.graph, SPECIAL)
        first, last = self.loads.start, self.loads.stop
        parts = [kernels.memory(part) for part in (entry[:first], entry[first:last], entry[last:])]
        results = function(kernels, *parts)
        return Recording([x for part in parts for x in part.items], tuple(list(result) for result in results))

    def state(self, constant: Mapping[int, Value], known: set[int]) -> list[Value]:
        """A complete state of inputs; those not ``known`` may be NaN."""
        return [constant[k] if k in constant else self.graph.input("state", k, unset=k not in known) for k in range(self.width)]

    def derived(self) -> set[int]:
        """Places of the state that follow from the parameters alone: kept once they are set, set again where they are NaN."""
        every = set(range(self.width))
        entry = self.state({}, every)
        kept = {k for k, x in enumerate(self.record(self.step, entry).state) if x is entry[k]}
        found = every - self.given
        while True:
            nan = dict.fromkeys(found, math.nan)
            after = self.record(self.step, self.state(nan, every)).state
            left = {k for k in found if k in kept and _by_parameters(after[k])} if nan else set()
            if left == found:
                return found
            found = left

    def script(self) -> Any:
        """The functions as a script; the loads are the first columns of its state."""
        derived = self.derived()
        constant: dict[int, Value] = dict.fromkeys(derived, math.nan)
        nan = [math.nan] * self.width
        start = self.record(self.start, nan)
        constant |= {k: x for k, x in enumerate(start.state) if not isinstance(x, Node)}
        while True:  # what no function changes from its value at the start is a number
            entry = self.state(constant, self.given)
            place, hold = self.record(self.place, entry), self.record(self.hold, entry)
            step = self.record(self.step, self.state(constant, self.given))
            after = (place.state, hold.state, step.state)
            changed = {k for k, x in constant.items() if k not in derived and not all(_same(x, state[k]) for state in after)}
            if not changed:
                break
            constant = {k: x for k, x in constant.items() if k not in changed}
        known = set(range(self.width)) - set(constant)
        while True:  # what has begun before the first step
            step = self.record(self.step, self.state(constant, known))
            begun = {k for k in known if k in self.given or not (is_unset(hold.state[k]) or is_unset(step.state[k]))}
            if begun == known:
                break
            known = begun
        recordings = {"start": start, "place": place, "hold": hold, "step": step}
        live = self.live([place, hold, step])
        rings = [k for k in sorted(live) if k in self.rings]
        numbers = [k for k in self.loads if self.arrays.posed]
        numbers += [k for k in sorted(live) if k not in self.rings and k not in numbers]
        columns = {"state": {k: n for n, k in enumerate(numbers)}}
        blocks, first = {}, len(numbers)
        for k in rings:
            blocks[k] = first, first + self.rings[k]
            first += self.rings[k]
        kept = [*numbers, *rings]
        texts = []
        for name, arguments in ARGUMENTS.items():
            found = recordings.get(name) or self.record(getattr(self, name), nan)
            results = list(found.results)
            if name in recordings:
                results.insert(0, [self.filled(found.state[k], k) for k in kept])
            texts.append(source(Function(name, arguments, tuple(results)), columns, blocks))
        tables = {i: torch.tensor(self.arrays.tables[i]) for i in range(self.count) if self.linked[i]}
        return module(texts, tables)

    def filled(self, x: Value, k: int) -> Value:
        """What is kept at ``k``: where that is a block, a number is as wide."""
        return Node("filled", (x, self.rings[k])) if k in self.rings and not isinstance(x, Node) else x

    def live(self, recordings: Sequence[Recording]) -> set[int]:
        """Places of the state that a result depends on, now or later."""
        found: set[int] = set()
        wanted = [x for recording in recordings for result in recording.results for x in result]
        seen: set[Node] = set()
        while wanted:
            x = wanted.pop()
            if isinstance(x, Node) and x not in seen:
                seen.add(x)
                if x.op == "input" and x.args[0] == "state" and x.args[1] not in found:
                    found.add(x.args[1])
                    wanted += [recording.state[x.args[1]] for recording in recordings]
                elif x.op != "input":
                    wanted += x.args
        return found


#: Functions of the module and what they take.
ARGUMENTS = {
    "start": ("theta", "joints", "drives", "speeds"),
    "place": ("theta", "state"),
    "hold": ("theta", "state", "commands"),
    "step": ("theta", "state", "commands"),
    "bend": ("theta", "joints", "load"),
    "stretch": ("theta", "joints", "load"),
    "read": ("theta", "drive", "joints", "ee", "tool"),
}


def _by_parameters(x: Value) -> bool:
    return x.value is not None if isinstance(x, Node) else x == x


def _same(a: Value, b: Value) -> bool:
    return a is b or (not isinstance(a, Node) and not isinstance(b, Node) and repr(float(a)) == repr(float(b)))


def _ends(k: Kernels, u: Value, p: Memory, i: int, s: Memory, j: int, size: int, dt: float) -> tuple[Value, ...]:
    """:func:`sysid.effects.input_delay.ends`: the inputs are one block of the state."""
    if not isinstance(p.items[i], Node):
        return u, u, 0.0
    past = s.items[j]
    new = past.unset if isinstance(past, Node) else True
    later, earlier, part, s.items[j] = k.graph.parts("delayed", 4, u, p.items[i], past, dt, new)
    return later, earlier, part


def _look_up(k: Kernels, x: Value, tables: Array, i: int, low: float, step: float) -> Value:
    return k.graph("looked_up", x, i, low, step) if np.isfinite(tables[i, 0]) else x  # a cylinder without a linkage


def _sincos(k: Kernels, x: Value) -> tuple[Value, Value]:
    return k.graph("sin", x), k.graph("cos", x)


#: Kernels that index memory by a value, or save time on one processor.
SPECIAL: dict[Any, Any] = {input_delay.ends: _ends, chain.look_up: _look_up, trig.sincos: _sincos}
