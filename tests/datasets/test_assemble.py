"""Tables of a version → recordings: rows in any order, each once; what the manifest states takes no memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from sysid.datasets import Store, ingest
from sysid.datasets.versions.assemble import dataset_of
from sysid.errors import StoreError

MACHINE = 'schema = 1\nname = "press"\nrate_hz = 100.0\n[[axes]]\nname = "ram"\nactuation = "velocity"\ndrives = "joint"\n'


def test_rows_come_in_any_order_and_each_once(tmp_path: Path) -> None:
    (tmp_path / "logs/run").mkdir(parents=True)
    (tmp_path / "machine.toml").write_text(MACHINE)
    times = np.arange(600) / 100.0
    table = pd.DataFrame({"time": times, "ram.command": np.sin(times), "ram.joint": np.cos(times)})
    table.to_csv(tmp_path / "logs/run/log.csv", index=False)
    made = ingest(tmp_path / "logs", tmp_path / "ws", machine=tmp_path / "machine.toml")
    store = Store(tmp_path / "ws")
    manifest, whole = store.manifest(made.reference), made.recordings[0].table
    rows = np.random.default_rng(0).permutation(len(whole))

    def batch(order: np.ndarray) -> pa.RecordBatch:
        columns = {"recording": [manifest["recordings"][0]["key"]] * len(order), "row": order}
        return pa.RecordBatch.from_pydict({**columns, **{name: whole[name].to_numpy()[order] for name in whole}})

    found = dataset_of(manifest, {0: [batch(rows[:200]), batch(rows[200:])]})
    pd.testing.assert_frame_equal(found.recordings[0].table, whole, check_names=False)
    for damaged in (rows[:-1], np.append(rows[:-1], rows[0])):
        with pytest.raises(StoreError, match="recording run"):
            dataset_of(manifest, {0: [batch(damaged)]})
    (item,) = manifest["recordings"]
    with pytest.raises(StoreError, match=f"{len(whole)} rows; expected 1000000000000000 rows"):
        dataset_of({**manifest, "recordings": [{**item, "rows": 10**15}]}, {0: [batch(rows)]})
