"""Tasks in this process and in processes of this machine."""

from __future__ import annotations

import os

import pytest
from tasks import doubled, killed, process_of, refused

from sysid.errors import InputError
from sysid.execution import LocalExecutor, TaskError, open_executor

CALLS = [(float(k),) for k in range(5)]


@pytest.mark.parametrize("workers", [1, 2])
def test_results_are_in_the_order_of_the_calls(workers: int) -> None:
    shares: list[float] = []
    assert LocalExecutor(workers).run(doubled, CALLS, lambda share, _: shares.append(share)) == [0.0, 2.0, 4.0, 6.0, 8.0]
    assert shares == sorted(shares)


def test_one_worker_is_this_process_and_several_are_others() -> None:
    assert set(LocalExecutor(1).run(process_of, CALLS)) == {os.getpid()}
    assert os.getpid() not in LocalExecutor(2).run(process_of, CALLS)


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_of_a_task_keeps_its_parts(workers: int) -> None:
    with pytest.raises(InputError) as caught:
        LocalExecutor(workers).run(refused, CALLS)
    assert (caught.value.where, caught.value.remedy) == ("log.csv", "Remove it.")


def test_a_worker_that_is_killed_is_reported() -> None:
    with pytest.raises(TaskError, match="ended without a result"):
        LocalExecutor(2).run(killed, CALLS)


def test_no_calls_are_no_work() -> None:
    assert LocalExecutor(2).run(doubled, []) == []


def test_without_settings_work_stays_in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SYSID_CLUSTER", raising=False)
    assert open_executor() == LocalExecutor(1)
    assert open_executor(workers=2) == LocalExecutor(2)
