"""Recordings that arrive in every order and way, and a watch that is killed: its state is that of an undisturbed one."""

from __future__ import annotations

import random
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from fleet_logs import one_lift
from log_feed import QUIET, Feed, watched_and_killed, write_log

from sysid.datasets import Store, ingest
from sysid.fleet import watch, watching
from sysid.fleet.effects import FleetEffect
from sysid.fleet.result import FleetMachine

DEADBAND = FleetEffect("valve_deadband", "boom", None, ("positive", "negative"))


def content(workspace: Path) -> dict[str, Any]:
    """What is to be the same: tables, roles, quality and raw files of every recording, and the values that are estimated."""
    store = Store(workspace)
    dataset, manifest = store.load("lift-1"), store.manifest("lift-1")
    channels = store.channels("lift-1")
    columns = ["recording", "source", "signal", "stamp_ns"]
    return {
        "tables": {r.name: (r.start_ns, r.rate_hz, r.table.to_csv()) for r in dataset.recordings},
        "roles": dict(dataset.splits),
        "quality": manifest["quality"]["recordings"],
        "sources": sorted((source.path, source.sha256, source.losses) for source in dataset.sources),
        "channels": channels.sort_values(columns, ignore_index=True).to_csv(),
        "state": (workspace / "fleet/watch/lift-1.json").read_text(),
    }


@pytest.mark.parametrize(
    ("count", "kills", "longest"),
    [
        pytest.param(10, 2, 4.0, id="10", marks=pytest.mark.slow),  # in this process: test_watch_arrivals.py
        pytest.param(1000, 20, 40.0, id="1000", marks=[pytest.mark.slow, pytest.mark.timeout(7200)]),
    ],
)
def test_the_state_is_that_of_an_undisturbed_watch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int, kills: int, longest: float
) -> None:
    def name_effects(location: str, reference: str, plant: str | None) -> FleetMachine:
        return FleetMachine(reference, "named", (DEADBAND,))

    monkeypatch.setattr(watching, "name_effects", name_effects)
    rng = random.Random(count)
    begun, source, logs = one_lift(tmp_path / "begun"), tmp_path / "source", tmp_path / "logs"
    logs.mkdir()
    names = [f"motion-{k:04d}" for k in range(count)]
    for k, name in enumerate(names):
        write_log(source / name / ("log.csv" if k % 3 else "log.parquet"), 100 + k, 0.08 if k < count // 2 else 0.11)
    shutil.copy(begun / "machine.toml", source / "machine.toml")
    shutil.copy(begun / "machine.toml", logs / "machine.toml")
    places = {name: tmp_path / name for name in ("undisturbed", "disturbed")}
    for place in places.values():
        ingest(begun, place, name="lift-1")
        watch(place, "lift-1")

    whole = watch(places["undisturbed"], "lift-1", [source], quiet_s=QUIET)
    assert len(whole.new) == count
    feed = Feed(source, logs, rng)
    with ThreadPoolExecutor(1) as pool:
        fed = pool.submit(feed.all, names)
        try:
            killed = watched_and_killed(places["disturbed"], logs, kills, longest, rng, lambda: not fed.done())
        except BaseException:
            feed.ended.set()
            raise
        fed.result()
    for _ in range(2):  # the second has nothing to do
        last = watch(places["disturbed"], "lift-1", [logs], quiet_s=QUIET)
    assert killed >= kills
    found = last.arrivals
    assert not any((last.new, last.dropped, last.noticed, found.added, found.replaced, found.waiting))
    assert len(found.repeated) == feed.ways["repeated"]
    assert len(found.left_out) == 5 * feed.ways["beside_bad_ones"]
    expected, actual = content(places["undisturbed"]), content(places["disturbed"])
    assert set(actual["tables"]) == set(expected["tables"])
    for key, value in expected.items():
        assert actual[key] == value, key
