"""NumPy archives: rollouts and time series of MuJoCo, and files that claim more than they have."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mujoco import rollout
from mujoco.sysid._src.timeseries import SignalType, TimeSeries
from robots import robot
from small_logs import write_log

from sysid.errors import InputError
from sysid.logs import ReadOptions, reader_for
from sysid.logs.inspection import inspect_file


def test_a_rollout_of_mujoco(tmp_path: Path) -> None:
    model = mujoco.MjModel.from_xml_path(str(robot("joint")))
    data = mujoco.MjData(model)
    state = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    control = np.sin(np.arange(200) / 20.0)[None, :, None]
    states, _ = rollout.rollout(model, data, state, control)
    np.savez(tmp_path / "run.npz", state=states, control=control)
    options = ReadOptions(time="state[0]", columns=frozenset({"state[1]", "control[0]"}))
    (stream,) = reader_for(tmp_path / "run.npz").read(tmp_path / "run.npz", options)
    assert set(stream.columns) == {"state[1]", "control[0]"}
    np.testing.assert_array_equal(stream.columns["state[1]"], states[0, :, 1])
    np.testing.assert_array_equal(stream.stamps["time"], np.round(1e9 * states[0, :, 0]).astype(np.int64))
    assert "state[2]" in stream.fields


def test_a_time_series_of_mujoco_names_its_columns(tmp_path: Path) -> None:
    times, data = np.arange(50) * 0.02, np.random.default_rng(0).normal(size=(50, 3))
    mapping = {"hinge_qpos": (SignalType.MjStateQPos, np.array([0])), "tip": (SignalType.MjSensor, np.array([1, 2]))}
    TimeSeries(times, data, mapping).save_to_disk(tmp_path / "run.npz")
    (stream,) = reader_for(tmp_path / "run.npz").read(tmp_path / "run.npz", ReadOptions())
    assert list(stream.columns) == ["hinge_qpos", "tip[0]", "tip[1]"]
    np.testing.assert_array_equal(stream.columns["tip[1]"], data[:, 2])
    assert stream.stamps["time"][1] == 20_000_000


def test_plain_arrays(tmp_path: Path) -> None:
    path = tmp_path / "log.npz"
    np.savez_compressed(
        path, time=np.arange(30) * 0.01, q=np.ones((30, 2), np.float32), pump=np.arange(30), setup=np.ones(4), name="a"
    )
    (stream,) = reader_for(path).read(path, ReadOptions())
    assert list(stream.columns) == ["q[0]", "q[1]", "pump"]
    assert stream.unread == {"name": "text", "setup": "4 rows instead of 30"}
    assert inspect_file(path).reader == "npz"


def archive(path: Path, **members: bytes) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in members.items():
            file.writestr(f"{name}.npy", content)
    return path


def header(shape: str, kind: str = "<f8", fortran: bool = False) -> bytes:
    text = f"{{'descr': '{kind}', 'fortran_order': {fortran}, 'shape': {shape}, }}"
    padded = text.ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(padded).to_bytes(2, "little") + padded.encode()


@pytest.mark.parametrize(
    ("begin", "zeros", "message"),
    [
        (header("(1000000000,)"), 0, "states 8000000000 bytes and has"),
        (header("(2,)")[:20], 0, "not readable as a NumPy archive"),
        (header("(2, 2)", fortran=True), 32, "Fortran order"),
        (b"\x93NUMPY\x09\x00", 100, "arrays of format"),
        (header("(5000000,)"), 40_000_000, "bytes unpack to"),
    ],
)
def test_damaged_archives(begin: bytes, zeros: int, message: str, tmp_path: Path) -> None:
    path = archive(tmp_path / "log.npz", time=begin + bytes(zeros))
    with pytest.raises(InputError, match=message):
        reader_for(path).read(path, ReadOptions())


def test_any_damaged_byte_is_an_error_of_the_file_or_none(tmp_path: Path) -> None:
    good, path = write_log(tmp_path, "arrays.npz").read_bytes(), tmp_path / "damaged.npz"
    rng = np.random.default_rng(0)
    for _ in range(400):
        data = bytearray(good)
        for at in rng.integers(0, len(data), rng.integers(1, 4)):
            data[at] = rng.integers(0, 256)
        path.write_bytes(bytes(data[: rng.integers(1, len(data) + 1)] if rng.random() < 0.2 else data))
        try:
            streams = reader_for(path).read(path, ReadOptions())
        except InputError:
            continue
        assert all(len(values) == len(stream) for stream in streams for values in stream.columns.values())


def test_objects_are_never_loaded(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    path = archive(tmp_path / "log.npz", thing=buffer.getvalue())
    with pytest.raises(InputError, match="no time column"):
        reader_for(path).read(path, ReadOptions())
    path.write_bytes(b"PK\x03\x04 and no more")
    with pytest.raises(InputError, match="not readable as a NumPy archive"):
        reader_for(path).read(path, ReadOptions())
