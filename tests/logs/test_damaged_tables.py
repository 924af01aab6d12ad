"""Tables and sqlite bags with damage anywhere: read, or refused with the file's name; nothing else is raised."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from attempts import attempt
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from sysid.errors import InputError
from sysid.logs import ReadOptions, reader_for, reader_named
from sysid.logs.inspection import inspect_file
from sysid.logs.reader import read_confined

#: SciPy's MATLAB reader crashes on some damage, which ends its own process.
READS_IN_PROCESSES = True


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """One good file of each format."""
    folder = tmp_path_factory.mktemp("tables")
    table = pd.DataFrame({"time": np.arange(20) / 10, "boom.cylinder [mm]": np.arange(20.0), "label": "x"})
    table.to_csv(folder / "a.csv", index=False)
    table.to_parquet(folder / "a.parquet")
    content = {"t": np.arange(20) / 10, "log": {"u": np.arange(20.0), "text": "abc"}, "q": np.ones((20, 2))}
    savemat(folder / "a.mat", content)
    savemat(folder / "packed.mat", content, do_compression=True)
    savemat(folder / "old.mat", {"t": np.arange(20) / 10, "u": np.arange(20.0)}, format="4")
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@settings(max_examples=examples(400), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), name=st.sampled_from(["a.csv", "a.parquet", "a.mat", "packed.mat", "old.mat"]))
def test_any_damage_to_a_table_ends_in_a_stream_or_a_reason(
    tmp_path: Path, samples: dict[str, bytes], data: st.DataObject, name: str
) -> None:
    damaged = bytearray(samples[name])
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    if data.draw(st.booleans()):
        del damaged[data.draw(st.integers(1, len(damaged))) :]
    path = tmp_path / name
    path.write_bytes(bytes(damaged))
    streams, refusal = attempt(InputError, lambda: read_confined(reader_for(path), path, ReadOptions()))
    assert streams is not None or name in refusal
    for stream in streams or ():
        assert all(len(values) == len(stream) for values in stream.columns.values())
    assert inspect_file(path).streams or inspect_file(path).refusal


@settings(max_examples=examples(150), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=st.text(alphabet="time,x[]\"'\n\r;\t 0123.-e#µ", max_size=80))
def test_any_text_is_a_table_or_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(text.encode())
    streams, refusal = attempt(InputError, lambda: reader_for(path).read(path, ReadOptions()))
    assert streams is not None or "a.csv" in refusal


@settings(max_examples=examples(150), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_damage_to_json_records_ends_in_a_stream_or_a_reason(tmp_path: Path, data: st.DataObject) -> None:
    damaged = bytearray(b'{"gain": 2, "log": [{"time": 0, "q": [1.5, -2e3], "on": true}, {"time": 0.5, "arm": {"u": null}}]}')
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.sampled_from(b'0123456789-.eE[]{}":, \xff\n'))
    path = tmp_path / "a.json"
    path.write_bytes(bytes(damaged))
    streams, refusal = attempt(InputError, lambda: reader_named("json", path).read(path, ReadOptions()))
    assert streams is not None or "a.json" in refusal
    for stream in streams or ():
        assert all(len(values) == len(stream) for values in stream.columns.values())
