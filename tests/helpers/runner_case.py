"""A runner around the sample crane in process: parts put together by hand, faults and truth at hand."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
from crane_model import Perfect, crane_plant

from sysid.machine import KnownEffect
from sysid.plant import Model, Plant, compile_plant
from sysid_rl.control import response_time, tune
from sysid_rl.run.chain import ControlChain, SignalPolicy
from sysid_rl.run.checks.settings import CheckSettings
from sysid_rl.run.cycle import Cycle
from sysid_rl.run.faults import FaultyTransport, Injection
from sysid_rl.run.limits import Limits, LimitSettings, limits_of
from sysid_rl.run.loop import Loop
from sysid_rl.run.modes.mode import Mode
from sysid_rl.run.operator import Operator, Unattended
from sysid_rl.run.recipe import LoopSettings
from sysid_rl.run.simulated import SimulatedTransport
from sysid_rl.run.state_estimator import StateEstimator
from sysid_rl.run.supervisor import Supervisor
from sysid_rl.run.valves import axis_valves
from sysid_rl.train.inverse_kinematics import InverseKinematics, chain_of_plant
from sysid_rl.train.reach import joint_limits, tips

Array = npt.NDArray[np.float64]
DT = 0.01
PLANT = crane_plant()
#: Joints in the middle of everything.
MIDDLE = np.array([0.0, 0.4, -1.2, 0.12])


@dataclass(frozen=True)
class Quick(Perfect):
    """A forward model that is the plant itself, compiled once."""

    def predict(self, q: npt.ArrayLike) -> Array:
        return tips(_compiled(), np.atleast_2d(np.asarray(q, dtype=np.float64)))


@cache
def _compiled() -> Model:
    return compile_plant(PLANT)


@cache
def inverse() -> InverseKinematics:
    low, high = joint_limits(PLANT)
    return InverseKinematics.of(chain_of_plant(PLANT), low, high)


class Traced(SimulatedTransport):
    """Keeps the truth of every step."""

    def measure(self) -> None:
        super().measure()
        if not hasattr(self, "joints"):
            self.joints, self.ends, self.drives, self.opened = [], [], [], []
        # Whether a valve was open in the step.
        self.opened.append(bool(not self.neutral and self.commands.any()))
        self.joints.append(self.truth.joints[0])
        self.ends.append(self.truth.ee[0])
        self.drives.append(self.truth.drive[0])


class RealTime(Traced):
    """The same by the system's clock: a loop that is held up is late."""

    def __init__(self, *given: Any, **named: Any) -> None:
        self._origin_ns = time.monotonic_ns()
        super().__init__(*given, **named)

    def now_ns(self) -> int:
        return time.monotonic_ns() - self._origin_ns

    def wait_until(self, ns: int) -> None:
        while (left := ns - self.now_ns()) > 0:
            time.sleep(left / 1e9)
        super().wait_until(self.now_ns())

    def write(self, commands: Array, enabled: bool) -> Array:
        super().wait_until(self.now_ns())
        return super().write(commands, enabled)


class Memory:
    """A recorder that keeps everything, until it is told to fail."""

    def __init__(self, fails_at: int | None = None) -> None:
        self.cycles: list[Cycle] = []
        self._fails_at = fails_at

    def record(self, cycle: Cycle) -> None:
        self.cycles.append(cycle)

    @property
    def fault(self) -> str:
        return "disk full" if self._fails_at is not None and len(self.cycles) >= self._fails_at else ""


def reopened(opened: Sequence[bool]) -> int:
    """Steps in which a valve was open after all were shut again for the first time, for three steps or more."""
    begun = list(opened).index(True)
    for k in range(begun, len(opened) - 2):
        if not any(opened[k : k + 3]):
            return sum(opened[k:])
    return 0


@dataclass
class Case:
    """A loop and what is around it."""

    loop: Loop
    machine: Traced
    transport: FaultyTransport
    recorder: Memory
    operator: Operator
    limits: Limits

    @property
    def cycles(self) -> list[Cycle]:
        return self.recorder.cycles

    def verdicts(self) -> dict[str, int]:
        """Check → the first turn in which it objected."""
        found: dict[str, int] = {}
        for cycle in self.cycles:
            for verdict in cycle.verdicts:
                found.setdefault(verdict.check, cycle.number)
        return found

    def states(self) -> list[str]:
        """Every state it was in, in order."""
        found: list[str] = []
        for cycle in self.cycles:
            if not found or found[-1] != cycle.state:
                found.append(cycle.state)
        return found


def true_crane(seed: int = 0) -> Plant:
    """A crane that is not quite what its plant says: gains, dead-bands, play."""
    rng = np.random.default_rng(seed)
    plant = PLANT
    for axis in plant.machine.axis_names:
        plant = plant.with_effect(KnownEffect("gain_error", axis, {"ratio": float(rng.uniform(0.88, 1.12))}))
    return plant.with_effect(KnownEffect("backlash", "slew", {"width": 0.008}, "drive"))


def case(
    mode: Callable[[Limits, ControlChain], Mode],
    *,
    start: Array = MIDDLE,
    true: Plant = PLANT,
    plan: Sequence[Injection] = (),
    policy: SignalPolicy | None = None,
    lookahead: float | None = None,
    limits: LimitSettings | None = None,
    checks: CheckSettings | None = None,
    recorder: Memory | None = None,
    operator: Callable[[FaultyTransport], Operator] = Unattended,
    noise: bool = True,
    seed: int = 0,
    kind: type[Traced] = Traced,
    first_move: bool = False,
    **settings: object,
) -> Case:
    """A loop that is ready to run; the plan's times count from the first turn. Its axes are released unless ``first_move``."""
    machine = kind(true, start, noise=noise, seed=seed)
    transport = FaultyTransport(machine, tuple(plan))
    ahead = response_time(PLANT) if lookahead is None else lookahead
    chain = ControlChain(PLANT, Quick(PLANT), inverse(), policy=policy, lookahead=round(ahead, 2))
    parts = axis_valves(tune(PLANT), DT)
    bounds = limits_of(PLANT, parts, limits or LimitSettings(), "test")
    rules = checks or CheckSettings()
    estimator = StateEstimator(PLANT, parts, DT, transport.signals, rules)
    supervisor = Supervisor(
        chain.axes, bounds, parts, estimator.linkages, chain.tip, DT, estimator.response, estimator.response_range, rules
    )
    if not first_move:
        begin, release = supervisor.first_move.begin, supervisor.first_move.skip
        supervisor.first_move.begin = lambda joints, drive: (begin(joints, drive), release())[1]  # type: ignore[method-assign]
    memory, person = recorder or Memory(), operator(transport)
    values = {"priority": 0, "lock_memory": False, "settle_s": 0.1, **settings}
    loop = Loop(transport, chain, estimator, supervisor, mode(bounds, chain), memory, person, LoopSettings(**values))  # type: ignore[arg-type]
    return Case(loop, machine, transport, memory, person, bounds)
