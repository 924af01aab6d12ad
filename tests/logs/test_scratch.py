"""Large arrays lie in mapped files: what is read comes back in one, the disk may be full, and nothing is left behind."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from sysid import scratch
from sysid.confined import confined
from sysid.errors import InputError, StorageError
from sysid.logs import ReadOptions, reader_for
from sysid.logs.limits import Budget
from sysid.logs.reader import read_confined
from sysid.scratch import Scratch

ROWS = 100_000


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Scratch]:
    """A scratch in which every array of some size lies in the file."""
    monkeypatch.setattr("sysid.scratch.FREE", 0)
    with scratch.scratch_in(tmp_path) as found:
        yield found


def blocks_of(own: Scratch) -> int:
    assert own.file is not None
    return 512 * os.fstat(own.file.fileno()).st_blocks


def write_log(folder: Path) -> Path:
    path = folder / "log.csv"
    path.write_text("time,x,y\n" + "".join(f"{0.01 * k:.2f},{k},\n" for k in range(ROWS)))
    return path


def test_small_arrays_stay_in_memory(tmp_path: Path) -> None:
    with scratch.scratch_in(tmp_path) as own:
        for count in (10, 2**17, 2**18):
            assert own.place(scratch.empty(count)) is None
        held = [scratch.empty(2**20) for _ in range(5)]
        assert [own.place(values) is None for values in held] == [True, True, True, True, False]
        del held
        assert own.place(scratch.empty(2**20)) is None  # there is room again
    assert scratch.empty(2**23).flags.owndata


def test_room_of_an_array_is_used_again(small: Scratch) -> None:
    places = set()
    for _ in range(5):
        values = scratch.filled(ROWS, 1.0)
        places.add(small.place(values))
        del values
    assert len(places) == 1


def test_room_of_an_array_is_given_back(small: Scratch, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sysid.scratch.MAX_FREE_LIST", 0)
    values = scratch.filled(2**20, 1.0)
    view = values[10:20]
    del values
    assert blocks_of(small) >= 8 * 2**20
    assert view.sum() == 10.0
    del view
    assert blocks_of(small) < 2**20


def test_arrays_that_left_the_process_are_as_they_were(small: Scratch) -> None:
    values = scratch.computed(ROWS, lambda first, last: np.arange(first, last) * 0.5)
    assert small.place(values) is not None
    scratch.leave()
    np.testing.assert_array_equal(values, np.arange(ROWS) * 0.5)


def test_what_is_put_into_the_file_is_in_the_array(small: Scratch) -> None:
    values = scratch.filled(ROWS, 1.0)
    assert values[-1] == 1.0
    scratch.put(values, 5000, np.arange(20_000))
    expected = np.ones(ROWS)
    expected[5000:25_000] = np.arange(20_000)
    np.testing.assert_array_equal(values, expected)
    scratch.put(values[30_000:], 7, np.zeros(10_000))
    expected[30_007:40_007] = 0.0
    np.testing.assert_array_equal(values, expected)


def test_a_forked_process_does_not_free_what_is_used_here(small: Scratch) -> None:
    values = scratch.filled(ROWS, 3.0)
    child = os.fork()
    if child == 0:
        del values
        os._exit(0)
    os.waitpid(child, 0)
    assert values.sum() == 3.0 * ROWS


def test_what_is_read_comes_back_in_the_file(tmp_path: Path, small: Scratch) -> None:
    path = write_log(tmp_path)
    (here,) = reader_for(path).read(path, ReadOptions())
    (there,) = read_confined(reader_for(path), path, ReadOptions())
    for one, other in ((here.stamps["time"], there.stamps["time"]), *((here.columns[c], there.columns[c]) for c in "xy")):
        assert small.place(other) is not None
        assert one.dtype == other.dtype
        assert one.tobytes() == other.tobytes()
    there.columns["x"][0] = 7.0
    assert there.columns["x"][:2].tolist() == [7.0, 1.0]


def test_a_process_has_no_arrays_of_the_one_that_reads(small: Scratch) -> None:
    values = scratch.filled(ROWS, 3.0)

    def work() -> int:
        values[:] = 0.0
        return 1

    budget = Budget.of(1)
    with pytest.raises(InputError, match="crashed"):
        confined(lambda report: work(), "log.csv", budget.limits, ())
    assert values.sum() == 3.0 * ROWS
    assert confined(lambda report: scratch.filled(ROWS, 2.0), "log.csv", budget.limits, ()).sum() == 2.0 * ROWS


def test_more_than_the_budget_is_an_error_of_the_file(small: Scratch) -> None:
    def work() -> None:
        held = [scratch.filled(2**20, 1.0) for _ in range(200)]
        raise AssertionError(len(held))

    with pytest.raises(InputError, match=r"log\.csv: takes more than 512 MiB to read"):
        confined(lambda report: work(), "log.csv", Budget.of(1).limits, ())


def no_room(*_: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_full_disk_is_said(tmp_path: Path, small: Scratch, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_log(tmp_path)
    monkeypatch.setattr("os.posix_fallocate", no_room)
    said = r"no room for scratch files \(No space left on device\); nothing was stored; expected .* MiB more.*Make room"
    with pytest.raises(StorageError, match=said):
        scratch.empty(ROWS)
    with pytest.raises(StorageError, match=said):
        read_confined(reader_for(path), path, ReadOptions())
    assert [file.name for file in tmp_path.iterdir()] == ["log.csv"]


@pytest.mark.parametrize("reason", ["no file can be made", "no room can be reserved"])
def test_without_a_file_arrays_stay_in_memory(
    reason: str, tmp_path: Path, small: Scratch, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS if reason == "no file can be made" else errno.EOPNOTSUPP, "no")

    monkeypatch.setattr("tempfile.TemporaryFile" if reason == "no file can be made" else "os.posix_fallocate", refused)
    path = write_log(tmp_path)
    (stream,) = read_confined(reader_for(path), path, ReadOptions())
    assert small.place(stream.columns["x"]) is None
    assert stream.columns["x"][-1] == ROWS - 1


def test_nothing_is_left_after_a_kill(tmp_path: Path) -> None:
    code = (
        "import sys, time\nfrom pathlib import Path\nfrom sysid import scratch\n"
        "with scratch.scratch_in(Path(sys.argv[1])) as own:\n"
        "    held = scratch.filled(2**23, 1.0)\n    assert own.place(held) is not None\n"
        "    print('there', flush=True)\n    time.sleep(60)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"there\n"
    assert list(tmp_path.iterdir()) == []
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    time.sleep(0.1)
    assert list(tmp_path.iterdir()) == []


def test_the_folder_need_not_be_there(tmp_path: Path) -> None:
    assert Scratch(tmp_path / "ws" / "deep").folder == tmp_path
