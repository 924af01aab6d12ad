"""The states of a run: every event in every state, and what no sequence of events can bring about."""

from __future__ import annotations

import itertools
from typing import get_args

import hypothesis.strategies as st
import pytest
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from sysid.errors import InputError
from sysid_rl.run.cycle import State
from sysid_rl.run.states import MOVING, PERSONAL, STATES, TABLE, Event, States

EVENTS = get_args(Event)

#: All that there is; everything else leads nowhere.
LEADS = {
    ("idle", "healthy"): "ready",
    ("ready", "unhealthy"): "idle",
    ("ready", "arm"): "armed",
    ("armed", "disarm"): "ready",
    ("armed", "stop"): "ready",
    ("armed", "unhealthy"): "idle",
    ("armed", "hold"): "running",
    ("running", "stop"): "stopping",
    ("stopping", "rest"): "ready",
    ("fault", "reset"): "idle",
}


@pytest.mark.parametrize(("state", "event"), list(itertools.product(STATES, EVENTS)))
def test_every_event_in_every_state(state: State, event: Event) -> None:
    expected = "fault" if event == "fault" else LEADS.get((state, event))
    assert TABLE.get((state, event)) == expected


class Sequences(RuleBasedStateMachine):
    """Any events in any order."""

    def __init__(self) -> None:
        super().__init__()
        self.states = States()
        self.armed_since_ready = False
        self.faulted = False

    @rule(event=st.sampled_from(EVENTS))
    def happens(self, event: Event) -> None:
        before = self.states.state
        moved = self.states.on(event, 0, f"because of {event}")
        after = self.states.state
        assert moved == (before != after)
        if after == "armed" and moved:
            assert event == "arm"
            self.armed_since_ready = True
        if after == "running" and moved:
            assert event == "hold"
            assert self.armed_since_ready, "nothing runs that nobody armed"
        if before == "fault" and after != "fault":
            assert event == "reset", "a fault stays until a person resets it"
        if after in ("ready", "idle", "fault"):
            self.armed_since_ready = False
        self.faulted = after == "fault"

    @invariant()
    def only_two_states_move(self) -> None:
        assert self.states.moving == (self.states.state in MOVING)

    @invariant()
    def a_fault_says_why(self) -> None:
        if self.faulted:
            assert self.states.why


TestSequences = Sequences.TestCase


def test_the_first_fault_is_the_one_that_is_told() -> None:
    states = States()
    assert states.on("fault", 5, "a wire is loose")
    assert not states.on("fault", 9, "nothing comes")
    assert (states.why, states.entered_ns) == ("a wire is loose", 5)


def test_what_a_person_asks_for_at_the_wrong_time_is_refused_with_what_is_possible() -> None:
    states = States()
    with pytest.raises(InputError, match="'arm' while idle; expected nothing: it must become ready by itself"):
        states.demand("arm", 0)
    states.on("fault", 0, "emergency stop")
    with pytest.raises(InputError, match=r"'arm' while fault \(emergency stop\); expected reset"):
        states.demand("arm", 0)
    states.demand("reset", 0)
    assert states.state == "idle"
    assert set(PERSONAL) < set(EVENTS)
