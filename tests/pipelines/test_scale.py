"""The pipeline that measures workers."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from sysid.datasets import Store, ingest
from sysid.execution import LocalExecutor


@pytest.fixture(scope="module")
def scale(pipeline: Callable[[str], ModuleType]) -> ModuleType:
    return pipeline("scale")


def test_tasks_and_their_bytes_are_counted(scale: ModuleType) -> None:
    executor = scale.MeasuredExecutor(LocalExecutor())
    with executor.kept() as kept:
        assert kept.run(scale.nothing, [(1,), (2,)]) == [1, 2]
    measures = executor.measures
    assert (measures.tasks, measures.sent) == (2, len(pickle.dumps((1,))) + len(pickle.dumps((2,))))
    assert measures.returned == len(pickle.dumps(1)) + len(pickle.dumps(2))
    assert measures.seconds > 0.0


def test_the_logs_are_recordings_of_the_demo_with_one_held_out(scale: ModuleType, tmp_path: Path) -> None:
    logs = scale.write_logs(tmp_path / "logs", 8)
    assert len(list((logs / "logs").iterdir())) == 8
    assert (logs / "logs/manual-0007/mocap.csv").read_bytes() == (scale.DEMO / "logs/manual-02/mocap.csv").read_bytes()
    assert 'held_out = ["manual-0007"]' in (logs / "recipe.toml").read_text()


def result(same: bool) -> dict[str, Any]:
    row = {"workers": 2, "seconds": 5.0, "tasks": 24, "task_seconds": 8.8, "overhead_s": 0.002, "same_result": same}
    row["caller_seconds"] = 0.6
    grown = {"caller_seconds": 0.5, "list_seconds": 0.002, "load_seconds": 0.1, "peak_bytes": 4e8}
    bytes_of = {"sent_bytes": 60_000, "returned_bytes": 30_000}
    return {
        "machine": "a processor",
        "commit": "abc",
        "settings": {"recordings": 6, "cores": 2, "seconds": 120.0},
        "alone": {"seconds": 8.0},
        "bytes": {"raw": 2_500_000, "tables": 1_500_000},
        "rows": [{**row, **bytes_of, "where": "processes"}, {**row, **bytes_of, "where": "cluster"}],
        "gap": [
            {"where": "threads of one process", "workers": 1, "seconds": 9.0, "same_result": True},
            {
                "where": "Dask cluster on loopback",
                "workers": 2,
                "seconds": 6.0,
                "same_result": same,
                "tasks": 7,
                "sent_bytes": 9000,
                "returned_bytes": 250_000,
            },
        ],
        "growth": [{**grown, "recordings": n, "seconds": 0.5 * n} for n in (6, 12)],
        "faults": [{"fault": "worker killed in mid-ingest", "same_result": same}],
    }


@pytest.mark.parametrize("same", [True, False])
def test_the_page_states_speed_up_waiting_bytes_and_whether_the_versions_agree(scale: ModuleType, same: bool) -> None:
    text = scale.tables(result(same))
    assert "| Dask cluster on loopback | 2 | 5.0 | 1.60 | 2.0 | 50 | 10 | 5 |" in text
    assert f"in {2 if same else 0} of 2 runs" in text
    assert f"| Dask cluster on loopback | 2 | 6.0 | 1.50 | 7 | 9 | 250 | {'yes' if same else '**no**'} |" in text
    assert f"| worker killed in mid-ingest | {'yes' if same else '**no**'} |" in text


def test_the_page_states_how_figures_grow_and_what_many_machines_would_cost(scale: ModuleType) -> None:
    """24 million recordings of 20 s: 1.47 s of tasks each on 1600 cores, 0.1 s of the caller, four empty tasks of 2 ms."""
    text = scale.tables(result(True))
    assert "| exponent | 1.00 | 0.00 | 0.00 | 0.00 | 0.00 |" in text
    assert "| 20 s | 0.42 MB | 24 000 000 | 6.1 h | 53 h | 6.7e+02 h | 3.6e+02 GB | caller |" in text
    assert "| 3600 s | 75.00 MB | 133 333 | 6.1 h | 0.3 h | 6.7e+02 h | 2 GB | caller |" in text


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_two_workers_and_a_killed_one_give_the_version_of_one_process(
    scale: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(scale.ROOT / "pipelines"), str(scale.ROOT)]))
    found = scale.study(tmp_path, [2], 4, [4, 6])
    assert [row["same_result"] for row in (*found["rows"], *found["faults"])] == [True, True, True]
    assert [row["same_result"] for row in found["gap"]] == [True, True, True]
    assert all(row["tasks"] == 16 and row["task_seconds"] > 0.0 for row in found["rows"])


def test_content_differs_where_a_version_does(scale: ModuleType, tmp_path: Path) -> None:
    from fleet_logs import MACHINE, recorded

    for k, band in enumerate((0.05, 0.08)):
        (tmp_path / f"logs-{k}/run").mkdir(parents=True)
        (tmp_path / f"logs-{k}/machine.toml").write_text(MACHINE)
        recorded(band, 1).to_csv(tmp_path / f"logs-{k}/run/log.csv", index=False)
        ingest(tmp_path / f"logs-{k}", tmp_path / f"ws-{k}")
    one, other = (scale.content(Store(tmp_path / f"ws-{k}"), "lift@1") for k in range(2))
    assert one != other
    assert one == scale.content(Store(tmp_path / "ws-0"), "lift@1")
