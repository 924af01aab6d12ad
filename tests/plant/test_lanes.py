"""Lanes of a model over the cores that other threads leave free."""

from __future__ import annotations

import threading

import pytest

from sysid.plant import model
from sysid.plant.model import core_taken, in_parallel


def threads_of(count: int, samples: int = 1 << 20) -> set[int]:
    """Threads that run the lanes; all of them have to be there at once where there are several."""
    there: set[int] = set()

    def lane(_: int) -> None:
        there.add(threading.get_ident())

    in_parallel(lane, count, samples)
    return there


def test_threads_that_are_busy_keep_their_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model, "WORKERS", 2)
    monkeypatch.setattr(model, "_pool", None)
    here = {threading.get_ident()}
    assert not threads_of(8) & here, "on the pool"
    with core_taken():
        assert not threads_of(8) & here, "one thread is busy: the one that waits for the lanes"
        with core_taken():
            assert threads_of(8) == here, "no core is free"
        assert not threads_of(8) & here
    assert threads_of(8, samples=1) == here, "a short run"


def test_a_core_is_free_again_after_an_error() -> None:
    with pytest.raises(ValueError, match="stage"), core_taken():
        raise ValueError("stage")
    assert model._busy == 0
