"""Reading in a process of its own: what comes back is what was read; what goes wrong there is an error of the file."""

from __future__ import annotations

import contextlib
import importlib
import os
import signal
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from read_here import read_here
from small_logs import LOGS, STATED, write_log

from sysid.confined import confined
from sysid.errors import InputError, SettingsError, SysidError
from sysid.logs import ReadOptions, Stream, reader_for, reader_named
from sysid.logs.limits import Budget
from sysid.logs.reader import read_confined

SMALL = replace(Budget.of(1), memory=64 * 2**20, seconds=30.0)


def run(work: Callable[[], Any], budget: Budget = SMALL, kinds: tuple[type, ...] = ()) -> Any:
    return confined(lambda report: work(), "log.csv", budget.limits, kinds)


@pytest.mark.parametrize("name", LOGS)
def test_every_reader_gives_the_same_in_a_process_of_its_own(name: str, tmp_path: Path) -> None:
    if name.endswith(".mf4"):
        pytest.importorskip("asammdf", reason="the extra that reads MDF files is not installed")
    for suffix, module in ((".ulg", "pyulog"), (".bin", "pymavlink")):
        if name.endswith(suffix):
            pytest.importorskip(module, reason="the extra that reads flight logs is not installed")
    path, options = write_log(tmp_path, name), ReadOptions(**STATED.get(name, {}))  # type: ignore[arg-type]
    reader = reader_named(LOGS[name][0], path)
    here, there = reader.read(path, options), read_confined(reader, path, options)
    assert len(here) == len(there)
    for one, other in zip(here, there, strict=True):
        assert replace(one, stamps={}, columns={}) == replace(other, stamps={}, columns={})
        for arrays, twins in ((one.stamps, other.stamps), (one.columns, other.columns)):
            assert list(arrays) == list(twins)
            for name_of, values in arrays.items():
                assert values.dtype == twins[name_of].dtype
                assert values.tobytes() == twins[name_of].tobytes()


def test_a_package_that_is_missing_is_no_fault_of_the_file() -> None:
    def work() -> None:
        importlib.import_module("no_such_package.inner")

    with pytest.raises(ModuleNotFoundError) as raised:
        run(work)
    assert raised.value.name == "no_such_package"


def test_an_array_of_several_names_comes_back_as_one() -> None:
    def work() -> Stream:
        stamps, values = np.arange(100_000), np.linspace(0.0, 1.0, 300_000)[::3]
        return Stream("a", Path("log.csv"), {"log": stamps}, {"x": values, "y": values}, {"x": "m"}, ("lost: ü",))

    stream = run(work, kinds=(Stream,))
    assert stream.columns["x"] is stream.columns["y"]
    np.testing.assert_array_equal(stream.columns["x"], np.linspace(0.0, 1.0, 300_000)[::3])
    assert (stream.source, stream.units, stream.losses) == (Path("log.csv"), {"x": "m"}, ("lost: ü",))


def fill_the_memory() -> None:
    held = [np.empty(2**20) for _ in range(2000)]  # address space is what is limited: nothing need be written
    raise AssertionError(len(held))


def count_for_ever() -> None:
    while True:
        pass


@pytest.mark.parametrize(
    ("work", "budget", "said"),
    [
        (fill_the_memory, SMALL, r"log\.csv: takes more than 64 MiB to read; expected what a log of its size takes"),
        (count_for_ever, replace(SMALL, seconds=1.0), r"log\.csv: takes more than 1 s; expected what a log of its size takes"),
        (lambda: time.sleep(60), replace(SMALL, seconds=0.01), r"log\.csv: takes more than 0 s"),
        (lambda: os.kill(os.getpid(), signal.SIGSEGV), SMALL, r"log\.csv: the reader crashed \(signal 11\)"),
        (os.abort, SMALL, r"log\.csv: the reader crashed \(signal 6\)"),
        (lambda: {}["a"], SMALL, r"log\.csv: cannot be read \(KeyError: 'a'\); expected a log of its format"),
    ],
    ids=["memory", "seconds", "waiting", "segmentation fault", "abort", "another error"],
)
def test_what_goes_wrong_is_an_error_of_the_file(work: Callable[[], Any], budget: Budget, said: str) -> None:
    with pytest.raises(InputError, match=said):
        run(work, budget)


def test_errors_come_back_as_they_were_raised() -> None:
    def work() -> None:
        raise SettingsError("recipe", "this", "that", "Do it.")

    with pytest.raises(SettingsError, match=r"^recipe: this; expected that\. Do it\.$"):
        run(work)
    with pytest.raises(PermissionError, match=r"log\.csv"):
        run(lambda: (_ for _ in ()).throw(PermissionError(13, "Permission denied", "log.csv")))


def damaged() -> None:
    raise KeyError("a")


def refused() -> None:
    raise InputError("log.csv", "this", "that", "Do it.")


def forbidden() -> None:
    raise PermissionError(13, "Permission denied", "log.csv")


def incomplete() -> None:
    raise ModuleNotFoundError("No module named 'absent'", name="absent")


@pytest.mark.parametrize("work", [damaged, refused, forbidden, incomplete])
def test_errors_where_other_tests_read_in_their_process_are_the_same(work: Callable[[], None]) -> None:
    errors = []
    for reads in (confined, read_here):
        with pytest.raises((SysidError, OSError, ModuleNotFoundError)) as caught:
            reads(lambda report: work(), "log.csv", SMALL.limits, ())
        errors.append((type(caught.value), str(caught.value)))
    assert errors[0] == errors[1]


def children() -> set[int]:
    """Processes that this one has started and not ended; other tests may have some."""
    return {int(number) for task in Path("/proc/self/task").iterdir() for number in (task / "children").read_text().split()}


def test_no_process_is_left_behind(tmp_path: Path) -> None:
    before = children()
    for work in (lambda: 1, os.abort, lambda: time.sleep(60)):
        with contextlib.suppress(InputError):
            run(work, replace(SMALL, seconds=0.01))
    assert children() <= before


def test_a_listener_that_raises_ends_the_reading(tmp_path: Path) -> None:
    def work(report: Callable[[float], None]) -> None:
        report(0.5)
        time.sleep(60)

    def listen(share: float) -> None:
        raise KeyboardInterrupt

    before = children()
    with pytest.raises(KeyboardInterrupt):
        confined(work, "log.csv", SMALL.limits, (), listen)
    assert children() <= before


def test_the_share_that_is_read_rises_with_the_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sysid.logs.table.CELLS", 3 * 2**13)
    path = tmp_path / "log.csv"
    path.write_text("time,x\n" + "".join(f"{0.01 * k:.2f},{k}\n" for k in range(200_000)))
    shares: list[float] = []
    (stream,) = read_confined(reader_for(path), path, ReadOptions(progress=shares.append))
    assert len(stream) == 200_000
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert max(np.diff([0.0, *shares])) < 0.2
