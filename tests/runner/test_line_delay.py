"""How late a line is: the machine's stamps against this computer's clock, and how soon commands are answered."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

import numpy as np
import pytest
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from sysid_rl.run.line_delay import ANSWERS, DRIFT, CommandRoundTrip, MachineClock

MS = 1_000_000


def lags(
    delay: Callable[[float], float], seconds: float, drift: float = 0.0, jitter: float = 2e-3
) -> tuple[list[float], list[float]]:
    """Ages that the clock gives to values, and the delays that they really have beyond the least one [s], a cycle each."""
    clock, rng = MachineClock(), np.random.default_rng(0)
    found, true = [], []
    for k in range(round(100 * seconds)):
        now = 0.01 * k
        late = delay(now) + rng.exponential(jitter)
        came = round((5.0 + now + 3e-4 + late) * 1e9)
        clock.tick(now * (1.0 + drift), came)
        found.append((came + 100_000 - clock.measured(came + 100_000)) * 1e-9)
        true.append(late)
    return found, true


def test_stamps_of_the_machine_come_to_this_clock() -> None:
    found, true = lags(lambda now: 0.0, 6.0)
    assert max(abs(a - b) for a, b in zip(found[200:], true[200:], strict=True)) < 1e-3, "the earliest arrival says when"
    clock = MachineClock()
    clock.tick(1.0, 5 * MS)
    assert clock.measured(5 * MS + 20 * MS) == 25 * MS, "of a cycle whose status was lost"
    assert clock.now(35 * MS) == pytest.approx(1.03)
    clock.tick(None, 15 * MS)
    assert clock.measured(15 * MS) == 15 * MS
    assert clock.now(15 * MS) is None


@pytest.mark.parametrize("rate", [0.002, 0.008, 0.02])
def test_a_delay_that_grows_slowly_is_seen(rate: float) -> None:
    """The worst that was tried: 8 and 20 ms a second. Of a second's growth no more than the drift of two clocks is missed."""
    found, true = lags(lambda now: rate * now, 30.0)
    missed = np.array(true) - np.array(found)
    assert missed.max() < DRIFT * 30.0 + 1e-3
    noticed = next(k for k, age in enumerate(found) if age > 0.045)
    assert true[noticed] < (0.05 if rate >= 0.008 else 0.055)


@pytest.mark.parametrize("drift", [-DRIFT, DRIFT])
def test_clocks_that_drift_are_no_delay(drift: float) -> None:
    found, _ = lags(lambda now: 0.0, 120.0, drift, jitter=1e-3)
    assert max(found) < 0.02


def test_a_line_that_stood_still_and_goes_on_late_is_late() -> None:
    """A jump of more than a second was taken for a clock that was set."""
    found, _ = lags(lambda now: 1.5 * (now > 2.0), 4.0, jitter=0.0)
    assert found[-1] == pytest.approx(1.5, abs=1e-3)


def ticked(clock: MachineClock, stamps: list[float], cycle: float = 0.01) -> list[float]:
    """Ages of values that come with these stamps, a cycle each [s]."""
    ages = []
    for k, stamp in enumerate(stamps):
        came = round(cycle * k * 1e9)
        clock.tick(stamp, came)
        ages.append((came - clock.measured(came)) * 1e-9)
    return ages


@pytest.mark.parametrize("to", [0.0, 50.0, 1e4])
def test_a_clock_that_was_set_is_a_fault_and_begins_anew(to: float) -> None:
    clock = MachineClock()
    ages = ticked(clock, [100.0 + 0.01 * k for k in range(100)] + [to + 0.01 * k for k in range(ANSWERS)])
    word = "back" if to < 100.0 else "ahead"
    assert re.search(rf"went {word} by .* s: it was set, or the machine has restarted", clock.late(1080 * MS))
    assert ages[-1] == 0.0
    assert clock.late(2000 * MS) == ""


@pytest.mark.parametrize("stamp", [0.0, 99.0, 101.99, 1e5])
def test_no_single_stamp_restarts_the_estimate(stamp: float) -> None:
    """Of a frame that was overtaken, or damaged on a line without a checksum."""
    stamps = [100.0 + 0.01 * k for k in range(300)]
    stamps[200] = stamp
    ages = ticked(MachineClock(), stamps)
    assert max(ages[:200] + ages[201:]) < 1e-6


def test_frames_that_waited_for_this_computer_are_no_late_line() -> None:
    clock = MachineClock()
    ticked(clock, [0.01 * k for k in range(100)])
    for k in range(100, 300):  # it stood still for two seconds
        clock.tick(0.01 * k, 3000 * MS)
    for k in range(300, 400):
        clock.tick(0.01 * k, 10 * MS * k)
        assert clock.late(10 * MS * k) == ""


def test_frames_that_overtake_each_other_do_not_hide_a_growing_delay() -> None:
    """One swapped pair every 0.6 s restarted the estimate each time: 20 ms/s were never seen."""
    clock, late = MachineClock(), 0.0
    order = list(range(1000))
    for k in range(60, 999, 60):
        order[k], order[k + 1] = order[k + 1], order[k]
    for k, number in enumerate(order):
        came = round((0.01 * k + 0.02 * 0.01 * k) * 1e9)
        clock.tick(0.01 * number, came)
        late = (came - clock.measured(came)) * 1e-9
        if late > 0.045:
            break
    # The first of a pair comes 10 ms early.
    assert 1.7 < 0.01 * k < 2.7


@settings(max_examples=examples(100))
@given(
    st.lists(st.tuples(st.integers(0, 999), st.integers(1, 4)), max_size=30),
    st.floats(0.002, 0.05),
    st.sampled_from([2.56, 64.0, math.inf]),
)
def test_a_growing_delay_is_seen_whatever_overtakes_what(swaps: list[tuple[int, int]], rate: float, period: float) -> None:
    """Frames out of order, stamps that begin anew: late by 60 ms is said before 100 ms."""
    clock, order = MachineClock(period), list(range(round(100 * 0.1 / rate)))
    for k, far in swaps:
        k %= len(order) - far
        order[k], order[k + far] = order[k + far], order[k]
    for k, number in enumerate(order):
        came = round((0.01 * k + rate * 0.01 * k) * 1e9)
        clock.tick(0.01 * number if math.isinf(period) else 0.01 * number % period, came)
    assert "ms late by the machine's clock" in clock.late(came)


@pytest.mark.parametrize("period", [2.56, 64.0, 429496.7296])
def test_a_clock_that_overflows_goes_on(period: float) -> None:
    clock = MachineClock(period)
    begin = period - 1.0
    assert max(ticked(clock, [(begin + 0.01 * k) % period for k in range(600)])) < 1e-5
    assert clock.late(6 * 10**9) == ""
    assert clock.now(6000 * MS) == pytest.approx((begin + 6.0) % period)


def answered(late: Callable[[int], int], turns: int, hear: Callable[[int], bool] = lambda turn: True) -> list[str]:
    """What is said of a line each cycle of 10 ms on which the answer to cycle k comes ``late(k)`` cycles after it."""
    trip, said, echo = CommandRoundTrip(), [], 200
    trip.echoed(echo, 0)  # of a runner before this one
    for turn in range(1, turns):
        now = 10 * MS * turn
        done = [k for k in range(1, turn) if k + late(k) <= turn]
        if done and hear(turn):
            echo = max(done) % 256
        trip.echoed(echo, now)
        said.append(trip.late(now))
        trip.sent(turn % 256, now + MS)
    return said


@pytest.mark.parametrize("late", [1, 2, 5])
def test_answers_within_60_ms_are_none_of_a_late_line(late: int) -> None:
    assert not any(answered(lambda turn: late, 1000))


def test_a_line_that_is_late_from_the_beginning_is_said_within_half_a_second() -> None:
    said = answered(lambda turn: 20, 100)
    first = next(k for k, text in enumerate(said) if text)
    assert first * 10 <= 500
    assert "not answered for 150 ms" in said[first]
    assert "answered after 199 ms (at most 60): the line is late" in said[60]


def test_one_long_pause_is_no_late_line() -> None:
    """The computer stood still for 100 ms: one set of commands is answered late, the next ones are not."""
    assert not any(answered(lambda turn: 10 if turn == 300 else 1, 600))


def test_a_delay_that_grows_on_both_ways_is_said_at_60_ms() -> None:
    said = answered(lambda turn: 1 + turn // 100, 2000)
    first = next(k for k, text in enumerate(said) if text)
    assert 600 <= first <= 700 + 10 * ANSWERS


def test_who_says_nothing_is_not_answered() -> None:
    trip = CommandRoundTrip()
    for turn in range(100):
        trip.echoed(17, 10 * MS * turn)
        assert trip.late(10 * MS * turn) == ""


def test_a_machine_that_hears_nothing() -> None:
    said = answered(lambda turn: 1, 200, hear=lambda turn: turn < 100)
    first = next(k for k, text in enumerate(said) if text)
    assert 100 + 14 <= first <= 100 + 18
