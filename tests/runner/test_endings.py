"""Every way to end a run is one way: nothing is sent that is too old, valves go neutral, the verdict is told."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from runner_case import DT, MIDDLE, Case, case, inverse, reopened

from sysid_rl.run import faults as f
from sysid_rl.run.cycle import Cycle
from sysid_rl.run.faults import FaultyTransport, Injection
from sysid_rl.run.modes.hold import Hold
from sysid_rl.run.modes.mode import Goal, Mode
from sysid_rl.run.operator import Interruptible, Unattended
from sysid_rl.run.policy_thread import PolicyError, PolicyThread

Array = npt.NDArray[np.float64]
AXES = ("slew", "boom", "stick", "telescope")
#: When the machine is in full motion [s].
AT = 1.0


class Sweep:
    """Setpoints that go to and fro for ``seconds``; or a target, for a policy to find setpoints."""

    name, moves, writes, computes = "sweep", True, True, True

    def __init__(self, seconds: float = 2.0, *, aims: bool = False) -> None:
        self._last, self._aims = round(seconds / DT), aims

    def begin(self, joints: Array, ee: Array) -> None:
        self._joints, self._ee = joints.copy(), ee.copy()

    def goal(self, k: int, joints: Array, ee: Array) -> Goal:
        if k >= self._last:
            return Goal("sweep", stop="sweep is done", done=True)
        if self._aims:
            aim = self._ee + np.array([0.0, 0.08 * np.sin(2.0 * k * DT), 0.0])
            return Goal("sweep", target=aim, aim=aim)
        return Goal("sweep", joints=self._joints + 0.15 * np.sin(2.0 * k * DT))


def run(mode: Mode, *plan: Injection, watch: Callable[[Cycle], None] | None = None, **settings: object) -> Case:
    made = case(lambda limits, chain: mode, plan=plan, **settings)  # type: ignore[arg-type]
    made.loop.warm_up(MIDDLE)
    made.loop.run(watch)
    return made


class Policy:
    """Inverse kinematics until it does what it should not."""

    inputs = (*(f"{axis}.joint" for axis in AXES), *(f"{what}.{axis}" for what in ("ee", "target") for axis in "xyz"))
    outputs = inputs[:4]

    def __init__(self, fails: Callable[[Array], Array], after: int = 40) -> None:
        self._fails, self._left, self._last = fails, after, None

    def act(self, observations: Array) -> Array:
        self._left -= 1
        if self._left < 0:
            return self._fails(self._last)
        self._last, _ = inverse().solve(observations[:, 7:10], observations[:, :4] if self._last is None else self._last)
        return self._last.copy()


def raises(error: BaseException) -> Callable[[Array], Array]:
    def act(last: Array) -> Array:
        raise error

    return act


class NamelessError(Exception):
    def __str__(self) -> str:
        raise ValueError("not even a text")


@pytest.mark.parametrize(
    ("fails", "text"),
    [
        (raises(RuntimeError("device lost")), "the policy fails: RuntimeError: device lost"),
        (raises(MemoryError()), "the policy fails: MemoryError"),
        (raises(SystemExit(3)), "the policy fails: SystemExit: 3"),
        (raises(KeyboardInterrupt()), "the policy fails: KeyboardInterrupt"),
        (raises(NamelessError()), "the policy fails: NamelessError"),
        (lambda last: None, "answers with NoneType, expected an array (1, 4)"),
        (lambda last: last.tolist(), "answers with list, expected an array (1, 4)"),
        (lambda last: last[0], "answers with float64 (4,), expected numbers (1, 4)"),
        (lambda last: last[:, :3], "answers with float64 (1, 3), expected numbers (1, 4)"),
        (lambda last: last.astype(str), "expected numbers (1, 4)"),
        (lambda last: last.astype(complex), "expected numbers (1, 4)"),
        (lambda last: last * np.inf, "a number that is not finite"),
    ],
)
def test_whatever_a_policy_raises_or_returns_the_fallback_goes_on(fails: Callable[[Array], Array], text: str) -> None:
    made = run(Sweep(1.0, aims=True), policy=Policy(fails))
    assert made.loop.outcome.ended == "done"
    sources = [cycle.source for cycle in made.cycles if cycle.state == "running"]
    assert sources[-5:] == ["fallback"] * 5
    (first,) = {verdict.text for cycle in made.cycles for verdict in cycle.verdicts if verdict.check == "policy"}
    assert text in first
    assert reopened(made.machine.opened) == 0


#: How often :func:`never` was ended.
stopped: list[int] = []


def never(last: Array) -> Array:
    try:
        while True:
            pass
    finally:
        stopped.append(1)


def waits(last: Array) -> Array:
    threading.Event().wait(60.0)
    return last


@pytest.mark.realtime
@pytest.mark.parametrize("fails", [never, waits])
def test_a_policy_that_hangs_is_left_behind(fails: Callable[[Array], Array], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sysid_rl.run.policy_thread.SIMULATED_S", 0.2)
    made = run(Sweep(1.0, aims=True), policy=Policy(fails))
    assert made.loop.outcome.ended == "done"
    running = [cycle for cycle in made.cycles if cycle.state == "running"]
    late = [verdict.reaction for cycle in running for verdict in cycle.verdicts if verdict.check == "policy"]
    assert late == ["clamp"] * 2 + ["hold"], "asked again twice, then no more"
    assert running[-1].source == "fallback"
    if fails is never:
        for _ in range(500):
            if stopped:
                return
            time.sleep(0.01)
        pytest.fail("it still computes")


@pytest.mark.realtime
def test_a_policy_that_is_late_once_is_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sysid_rl.run.policy_thread.SIMULATED_S", 0.1)
    policy = Policy(lambda last: last)
    answer, gate = policy.act, threading.Event()
    requested = 0

    def act(observations: Array) -> Array:
        nonlocal requested
        requested += 1
        if requested == 20:
            gate.wait(5.0)
        return answer(observations)

    def watch(cycle: Cycle) -> None:
        if any(verdict.check == "policy" for verdict in cycle.verdicts):
            gate.set()
            time.sleep(0.05)  # until its late answer is there, to be dropped

    monkeypatch.setattr(policy, "act", act)
    made = run(Sweep(1.0, aims=True), policy=policy, watch=watch)
    assert made.loop.outcome.ended == "done"
    sources = [cycle.source for cycle in made.cycles if cycle.state == "running"]
    assert sources.count("fallback") == 1
    assert sources[-2] == "sweep"


@pytest.mark.realtime
def test_a_policy_that_is_cancelled_at_any_moment_answers_again() -> None:
    """Early or late by a hair, a hundred times: the exception comes before, in and after its answer."""

    class Slow:
        calls = 0

        def act(self, observations: Array) -> Array:
            self.calls += 1
            end = time.monotonic() + 1e-3 * (0.8 + 0.004 * min(self.calls, 100))  # 0.8 to 1.2 of the time limit
            while time.monotonic() < end:
                pass
            return observations[:, :4]

    thread = PolicyThread(Slow(), 4)
    answers = late = 0
    for k in range(100):
        try:
            thread.ask(np.full((1, 5), float(k)), time.monotonic_ns() + 1_000_000, time.monotonic_ns)
        except PolicyError as error:
            late += error.late
    for k in range(200):
        try:
            answer = thread.ask(np.full((1, 5), float(k)), time.monotonic_ns() + 200_000_000, time.monotonic_ns)
        except PolicyError:
            time.sleep(0.01)
            continue
        answers += 1
        assert np.array_equal(answer, np.full(4, float(k))), "of this question and no earlier one"
        if answers == 3:
            break
    assert late
    assert answers == 3


@pytest.mark.parametrize("error", [RuntimeError("no way on"), MemoryError(), KeyboardInterrupt(), SystemExit(1)])
def test_whatever_fails_in_the_loop_the_valves_go_neutral_and_the_run_is_told(error: BaseException) -> None:
    class Broken(Sweep):
        def goal(self, k: int, joints: Array, ee: Array) -> Goal:
            if k == 60:
                raise error
            return super().goal(k, joints, ee)

    made = run(Broken())
    outcome = made.loop.outcome
    assert (outcome.ended, outcome.state) == ("fault", "fault")
    assert outcome.why.startswith("interrupted (" if isinstance(error, KeyboardInterrupt) else "the runner failed: ")
    assert "test_endings.py, line" in outcome.why
    assert type(error).__name__ in outcome.error
    assert "\n" not in outcome.why
    assert reopened(made.machine.opened) == 0
    assert made.machine.opened[-5:] == [False] * 5


def test_a_line_that_cannot_be_read_still_gets_the_fail_safe_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[tuple[float, bool]] = []
    write = FaultyTransport.write

    def written(self: FaultyTransport, commands: Array, enabled: bool) -> Array:
        sent.append((self.now_ns() / 1e9, enabled))
        return write(self, commands, enabled)

    monkeypatch.setattr(FaultyTransport, "write", written)
    made = run(Sweep(), Injection(f.ReadFails(), AT))
    assert made.loop.outcome.ended == "fault"
    assert made.loop.outcome.why == "the line is dead: the adapter does not read"
    after = [enabled for at, enabled in sent if at >= AT + DT]
    assert len(after) > 20
    assert not any(after)


class HeldUp(Sweep):
    """The machine goes on for ``seconds`` between seeing and sending: a page of memory, another process."""

    def __init__(self, seconds: float) -> None:
        super().__init__()
        self._seconds, self.at = seconds, 0

    def goal(self, k: int, joints: Array, ee: Array) -> Goal:
        if k == 60:
            self.machine.wait_until(self.machine.now_ns() + round(self._seconds * 1e9))
            self.at = len(self.machine.opened)
        return super().goal(k, joints, ee)


def held_up(seconds: float) -> tuple[Case, HeldUp, list[tuple[float, Array]]]:
    """A run, its mode, and what was sent and when."""
    mode, sent = HeldUp(seconds), []
    made = case(lambda limits, chain: mode)
    mode.machine = made.machine
    write = made.machine.write

    def written(commands: Array, enabled: bool) -> Array:
        sent.append((made.machine.now_ns() / 1e9, commands * enabled))
        return write(commands, enabled)

    made.machine.write = written  # type: ignore[method-assign]
    made.loop.warm_up(MIDDLE)
    made.loop.run()
    return made, mode, sent


def test_a_turn_that_was_held_up_longer_than_the_machine_waits_opens_nothing_again() -> None:
    made, mode, _ = held_up(0.3)
    assert made.loop.outcome.ended == "fault"
    assert "no command went out for 3" in made.loop.outcome.why
    assert made.cycles[made.verdicts()["expired"]].state == "fault"
    assert not any(made.machine.opened[mode.at + 1 :])


def test_a_turn_that_was_held_up_a_little_is_dropped_and_the_next_one_goes_on() -> None:
    made, _, sent = held_up(0.06)
    assert made.loop.outcome.ended == "done"
    cycle = made.cycles[made.verdicts()["expired"]]
    assert (cycle.source, cycle.enabled) == ("dropped", True)
    assert np.array_equal(cycle.commands, made.cycles[cycle.number - 1].commands), "what the machine goes on with"
    times = np.array([at for at, _ in sent])
    assert np.diff(times).max() == pytest.approx(0.07, abs=1e-6), "nothing was sent in it"
    assert reopened(made.machine.opened) == 0


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGTSTP", "SIGUSR1"])
def test_a_signal_stops_within_the_limits_and_ends_the_run(name: str) -> None:
    def watch(cycle: Cycle) -> None:
        if cycle.number == 100:
            os.kill(os.getpid(), getattr(signal, name))

    made = case(lambda limits, chain: Sweep(), operator=lambda machine: Interruptible(Unattended(machine)))
    made.loop.warm_up(MIDDLE)
    with made.operator:  # type: ignore[attr-defined]
        made.loop.run(watch)
    assert made.states() == ["idle", "ready", "armed", "running", "stopping", "ready"]
    assert (made.loop.outcome.ended, made.loop.outcome.why) == ("quit", name)
    ramp = [cycle for cycle in made.cycles if cycle.source == "stop" and cycle.enabled]
    assert len(ramp) > 5
    assert reopened(made.machine.opened) == 0


def test_a_second_signal_puts_the_valves_to_neutral_at_once() -> None:
    def watch(cycle: Cycle) -> None:
        if cycle.number in (100, 102):
            os.kill(os.getpid(), signal.SIGTERM)

    made = case(lambda limits, chain: Sweep(), operator=lambda machine: Interruptible(Unattended(machine)))
    made.loop.warm_up(MIDDLE)
    with made.operator:  # type: ignore[attr-defined]
        made.loop.run(watch)
    assert made.states()[-2:] == ["stopping", "fault"]
    assert made.loop.outcome.ended == "fault"
    assert not any(cycle.enabled for cycle in made.cycles[103:])
    assert len(made.cycles) > 120, "neutral is said for a while, so that it is heard"


def test_a_third_signal_ends_a_loop_that_does_not_go_on() -> None:
    class Stuck(Hold):
        def goal(self, k: int, joints: Array, ee: Array) -> Goal:
            for _ in range(3 if k == 5 else 0):
                os.kill(os.getpid(), signal.SIGTERM)
            return super().goal(k, joints, ee)

    made = case(lambda limits, chain: Stuck(DT), operator=lambda machine: Interruptible(Unattended(machine)))
    made.loop.warm_up(MIDDLE)
    with made.operator:  # type: ignore[attr-defined]
        made.loop.run()
    assert made.loop.outcome.why.startswith("interrupted (")
    assert made.machine.neutral


def test_handlers_are_given_back() -> None:
    before = [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGTTIN)]
    with Interruptible(Unattended(None)):  # type: ignore[arg-type]
        assert signal.getsignal(signal.SIGTERM) != before[0]
    assert [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGTTIN)] == before


def test_who_types_abort_or_quit_is_obeyed() -> None:
    for word, ended, last in (("quit", "quit", "ready"), ("abort: too close", "fault", "fault")):
        made = case(lambda limits, chain: Sweep(), operator=lambda machine, word=word: Unattended(machine, [(1.0, word)]))
        made.loop.warm_up(MIDDLE)
        made.loop.run()
        assert (made.loop.outcome.ended, made.states()[-1]) == (ended, last)
    assert made.loop.outcome.why == "too close"
