"""Runs of a machine in the workspace: their records, items, pages, and place in the lineage."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from flights import cycle
from run_records import LATE, keep_run
from sample_workspace import sample_workspace

from sysid.datasets.versions.index import VersionIndex
from sysid.site import build_site, inventory
from sysid.site.inventory import dataset_items
from sysid_rl.run.cycle import Cycle
from sysid_rl.run.run_record import EventRecorder, Recorders


def test_a_violation_over_consecutive_cycles_is_one_event() -> None:
    events = EventRecorder()
    for number in (0, 1, 2, 4, 5):
        events.record(cycle(number, 10_000_000, (LATE,) if number in (1, 2, 5) else ()))
    shown = [(round(event["time_s"], 3), event["kind"], event.get("cycles")) for event in events.events]
    assert shown == [(0.0, "state", None), (0.01, "violation", 2), (0.05, "violation", 1)]


def test_events_above_the_limit_are_counted() -> None:
    events = EventRecorder(most=2)
    for number in range(10):
        events.record(cycle(number, 1, (LATE,) if number % 2 else ()))
    assert (len(events.events), events.lost) == (2, 4)


def test_recorders_pass_every_cycle_on_and_the_log_states_the_fault() -> None:
    class Log:
        fault = "disk full"

        def __init__(self) -> None:
            self.cycles: list[Cycle] = []

        def record(self, cycle: Cycle) -> None:
            self.cycles.append(cycle)

    first, log = Log(), Log()
    recorders = Recorders(first)
    recorders.record(cycle(0))
    assert recorders.fault == ""
    recorders.log = log
    recorders.record(cycle(1))
    assert ([item.number for item in first.cycles], [item.number for item in log.cycles]) == ([0, 1], [1])
    assert recorders.fault == "disk full"


def test_a_run_has_an_item_with_its_versions_and_the_figures_of_the_console(tmp_path: Path) -> None:
    place = sample_workspace(tmp_path / "ws")
    keep_run(place, tmp_path / "logs")
    run = next(item for item in inventory(place) if item.kind == "flight")
    assert run.parents == ("plant:autolog@2",), "a version that is not in the registry is no source"
    assert "ended: fault, state fault, boom.cylinder is 120 ms old" in run.summary
    assert "tracking error RMSE 10.05 mm" in run.summary
    assert {fact.text for fact in run.facts if fact.group == "Tracking error, distance"} == {"8.91 mm", "10.05 mm", "21.00 mm"}
    page = (build_site(place).index.parent / run.path).read_text("utf-8")
    for text in ("10.05", "21.00", "stale of boom.cylinder", "boom.cylinder is 120 ms old; at most 50 ms", "helix by ik"):
        assert text in page
    assert 'class="refused"' in page
    assert str(tmp_path / "logs/motion-20260503T141500/flight.mcap") in page


def test_a_run_of_other_content_than_the_registry_holds_is_not_linked(tmp_path: Path) -> None:
    place = sample_workspace(tmp_path / "ws")
    record = keep_run(place, tmp_path / "logs")
    path = place.root.path(record.path)
    values = json.loads(path.read_text())
    path.write_text(json.dumps({**values, "versions": {"autolog@2": "11" * 32}}))
    assert next(item for item in inventory(place) if item.kind == "flight").parents == ()


def test_a_dataset_that_was_made_from_a_flight_log_follows_from_the_run(tmp_path: Path) -> None:
    place = sample_workspace(tmp_path / "ws")
    index = VersionIndex(place.location)
    digest = index.manifest("autolog@1")["sources"][0]["sha256"]
    found = list(dataset_items(index, {digest: "flight:motion-1"}))
    logs = next(item for item in found if item.key == "logs:autolog@1")
    assert logs.parents == ("flight:motion-1",)
    assert next(item for item in found if item.key == "dataset:autolog@1").parents == (logs.key,)


def test_a_run_that_did_not_end_and_a_damaged_record_are_shown(tmp_path: Path) -> None:
    place = sample_workspace(tmp_path / "ws")
    keep_run(place, tmp_path / "logs", result=None)
    (place.root.folder / "flights/motion-2.json").write_text('{"schema": 1}')
    built = build_site(place)
    assert not built.failed
    assert (
        "not ended: the run goes on, or it was killed"
        in (built.index.parent / "flights/motion-20260503T141500.html").read_text()
    )
    assert "record of the run motion-2" in built.index.read_text()


def test_a_record_with_other_content_leaves_the_other_pages_alone(tmp_path: Path) -> None:
    place = sample_workspace(tmp_path / "ws")
    path = place.root.path(keep_run(place, tmp_path / "logs").path)
    path.write_text(json.dumps(json.loads(path.read_text()) | {"events": [{"kind": "state"}]}))
    built = build_site(place)
    assert list(built.failed) == ["flights/motion-20260503T141500.html"]
    assert (
        "damaged: KeyError: 'time_s'; expected what `sysid run` writes" in built.failed["flights/motion-20260503T141500.html"]
    )
    assert "index.html" in built.made


def test_a_workspace_that_cannot_be_written_is_an_error_of_the_record_alone(tmp_path: Path) -> None:
    place = sample_workspace(tmp_path / "ws")
    (place.root.folder / "flights").write_text("in the way")
    with pytest.raises(OSError, match="Not a directory"):
        keep_run(place, tmp_path / "logs")
