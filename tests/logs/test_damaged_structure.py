"""Every format with its structure damaged: read, or refused with the name of the file; nothing is misread.

The other half are findings of the fuzzers (``make fuzz``), each made again by hand.
"""

from __future__ import annotations

import functools
import re
import sqlite3
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from attempts import attempt
from examples import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import Writer as McapWriter
from small_logs import LOGS, MOTIVE_1_25, MOTIVE_EULER, STATED, write_log

from sysid.errors import InputError
from sysid.logs import ReadOptions, Stream, reader_for, reader_named
from sysid.logs.inspection import inspect_file

TEXT = {".csv", ".tsv", ".trc", ".asc", ".log", ".json"}
#: What a length, a count, a stamp or a number may be instead.
WORDS = [
    bytes(4),
    b"\xff" * 4,
    b"\xff\xff\xff\x7f",
    b"\0\0\0\x80",
    b"\1\0\0\0",
    b"\0\0\0\1",
    b"\0\0\xc0\x7f",
    bytes(8),
    b"\xff" * 8,
]
CELLS = ["", "nan", "inf", "-1", "1e400", "-1e18", "9" * 40, "0", "x", '"', "é", "#", "1,5", "-1.#IND", "2.0", "0.1", "\0"]


@functools.cache
def original(name: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        return write_log(Path(folder), name).read_bytes()


def read(path: Path, name: str) -> tuple[tuple[Stream, ...] | None, str]:
    options = ReadOptions(**STATED.get(name, {}))  # type: ignore[arg-type]
    return attempt(InputError, lambda: reader_named(LOGS[name][0], path).read(path, options))


#: Where, where else, how much, what with; taken modulo what there is.
PLACE = st.integers(0, 2**20)
BYTES_STEP = st.tuples(
    st.sampled_from(["word", "swap", "repeat", "drop", "cut", "zero"]),
    PLACE, PLACE, st.sampled_from([1, 2, 4, 8, 16, 64, 512]), st.sampled_from(WORDS),
)  # fmt: skip
TEXT_STEP = st.tuples(
    st.sampled_from(["cell", "number", "swap lines", "repeat", "drop", "swap cells", "cut"]),
    PLACE, PLACE, PLACE, st.sampled_from(CELLS),
)  # fmt: skip


def damaged_bytes(data: bytes, steps: list[tuple[str, int, int, int, bytes]]) -> bytes:
    """Pieces of the file swapped, repeated, left out, or numbers in it replaced by extreme ones."""
    result = bytearray(data)
    for what, at, other, size, word in steps:
        at, other = at % max(len(result), 1), other % max(len(result), 1)
        match what:
            case "word":
                result[at : at + len(word)] = word
            case "swap":
                first, second = bytes(result[at : at + size]), bytes(result[other : other + size])
                result[at : at + size], result[other : other + size] = second, first
            case "repeat":
                result[other:other] = result[at : at + size]
            case "drop":
                del result[at : at + size]
            case "cut":
                del result[at:]
            case "zero":
                result[at : at + size] = bytes(size)
    return bytes(result)


def rewritten(data: bytes, steps: list[tuple[str, int, int, int, str]], line_end: bool) -> bytes:
    """Lines of a text swapped, repeated or left out, and cells replaced by what no program should write."""
    lines = [re.split(r"([,;\t ])", line) for line in data.decode("utf-8").splitlines()]
    for what, at, other, place, cell in steps:
        if not lines:
            break
        at, other = at % len(lines), other % len(lines)
        line = lines[at]
        numbers = [i for i, text in enumerate(line) if re.fullmatch(r"-?\d+(\.\d+)?", text)]
        match what:
            case "cell" if line:
                line[place % len(line)] = cell
            case "number" if numbers:
                line[numbers[place % len(numbers)]] = cell
            case "swap lines":
                lines[at], lines[other] = lines[other], line
            case "repeat":
                lines.insert(other, list(line))
            case "drop":
                del lines[at]
            case "swap cells" if line:
                first, second = place % len(line), other % len(line)
                line[first], line[second] = line[second], line[first]
            case "cut" if line:
                del line[place % len(line) :]
    return "\r\n".join("".join(line) for line in lines).encode("utf-8") + (b"\r\n" if line_end else b"")


def check(path: Path, name: str, data: bytes) -> None:
    path.write_bytes(data)
    streams, refusal = read(path, name)
    assert streams is not None or name in refusal
    for stream in streams or ():
        assert len(stream)
        assert all(len(values) == len(stream) for values in (*stream.columns.values(), *stream.stamps.values()))
    seen = inspect_file(path, LOGS[name][0])
    assert seen.streams or name in seen.refusal


@settings(max_examples=examples(120), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(name=st.sampled_from(sorted(set(LOGS) - {"log.mf4"})), steps=st.lists(BYTES_STEP, min_size=1, max_size=3))
def test_any_damage_to_any_format_ends_in_streams_or_a_reason(
    tmp_path: Path, name: str, steps: list[tuple[str, int, int, int, bytes]]
) -> None:
    check(tmp_path / name, name, damaged_bytes(original(name), steps))


@settings(max_examples=examples(80), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    name=st.sampled_from([name for name in sorted(LOGS) if Path(name).suffix in TEXT]),
    steps=st.lists(TEXT_STEP, min_size=1, max_size=4),
    line_end=st.booleans(),
)
def test_any_rewriting_of_a_text_ends_in_streams_or_a_reason(
    tmp_path: Path, name: str, steps: list[tuple[str, int, int, int, str]], line_end: bool
) -> None:
    check(tmp_path / name, name, rewritten(original(name), steps, line_end))


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(steps=st.lists(BYTES_STEP, min_size=1, max_size=3))
def test_any_damage_to_mdf_ends_in_streams_or_a_reason(tmp_path: Path, steps: list[tuple[str, int, int, int, bytes]]) -> None:
    check(tmp_path / "log.mf4", "log.mf4", damaged_bytes(original("log.mf4"), steps))


@pytest.mark.parametrize("name", sorted(LOGS))
def test_a_file_that_is_cut_off_gives_no_other_numbers(tmp_path: Path, name: str) -> None:
    """What is read of a part is the beginning of what is read of the whole."""
    whole_path, part_path = tmp_path / "whole" / name, tmp_path / "part" / name
    for path in (whole_path, part_path):
        path.parent.mkdir()
    whole_path.write_bytes(original(name))
    streams, _ = read(whole_path, name)
    whole = {stream.name: stream for stream in streams or ()}
    assert whole
    for share in (0.3, 0.5, 0.7, 0.9, 0.97):
        part_path.write_bytes(original(name)[: int(share * len(original(name)))])
        for stream in read(part_path, name)[0] or ():
            assert len(stream) <= len(whole[stream.name])
            for column, values in stream.columns.items():
                if column in whole[stream.name].columns:
                    same = whole[stream.name].columns[column][: len(values)]
                    assert ((values == same) | np.isnan(values)).all(), f"{share}: {stream.name} {column}"


def test_rotations_without_an_axis_are_refused(tmp_path: Path) -> None:
    for lines, where in ((MOTIVE_1_25, "X, Z, W"), (MOTIVE_EULER, "X, Z")):
        head = next(i for i, line in enumerate(lines) if line.startswith("Frame"))
        broken = [*lines[:head], lines[head].replace("X,Y,Z", "X,,Z", 1), *lines[head + 1 :]]
        path = tmp_path / "take.csv"
        path.write_text("\n".join([*broken, ""]))
        with pytest.raises(InputError, match=rf"take\.csv: boom: rotation {where}; expected X, Y, Z"):
            reader_for(path).read(path, ReadOptions(length_unit=None if "1.25" in lines[0] else "m"))


def test_rows_of_a_bag_without_a_message_are_left_out(tmp_path: Path) -> None:
    path = write_log(tmp_path, "log.db3")
    with sqlite3.connect(path) as database:
        database.execute("UPDATE messages SET data = NULL WHERE id = 3")
        database.execute("UPDATE messages SET data = 'text' WHERE id = 4")
        database.execute("UPDATE messages SET timestamp = 'late' WHERE id = 5")
    database.close()
    (stream,) = reader_for(path).read(path, ReadOptions())
    assert len(stream) == 9
    assert "log.db3: 3 rows without a stamp and a message have been left out" in stream.losses


def test_a_topic_without_one_readable_message_is_reported_beside_the_others(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        schema = writer.register_schema("p/msg/M", "ros2msg", b"float64 x\n")
        for topic, data in (("/good", b"\0\1\0\0" + bytes(8)), ("/bad", b"\0\1\0\0" + bytes(3))):
            writer.add_message(writer.register_channel(topic, "cdr", schema), 2**63 + 5, data, 2**63 + 5)
        writer.finish()
    (stream,) = reader_for(path).read(path, ReadOptions())
    assert (stream.name, len(stream)) == ("/good", 1)
    assert stream.losses == (
        "log.mcap: /bad: 1 messages do not follow their schema (the first: the message ends after 7 bytes)",
    )
    assert inspect_file(path).losses == stream.losses
    with pytest.raises(InputError, match=r"log\.mcap: /bad: log\.mcap: /bad: 1 messages do not follow their schema"):
        reader_for(path).read(path, ReadOptions(streams=frozenset({"/good", "/bad"})))


def test_negative_sizes_of_a_matrix_are_refused(tmp_path: Path) -> None:
    path = write_log(tmp_path, "plain.mat")
    data = path.read_bytes()
    sizes = data.index(b"\5\0\0\0\x08\0\0\0\x01\0\0\0\x0c\0\0\0") + 8
    path.write_bytes(data[:sizes] + b"\xff" * 8 + data[sizes + 8 :])
    with pytest.raises(InputError, match=r"plain\.mat: .*a size of -1 × -1"):
        reader_for(path).read(path, ReadOptions())


#: Sizes that a file only claims; read where little memory is left.
CLAIMS = """
import resource, struct, sys
from pathlib import Path
from sysid.errors import InputError
from sysid.logs import ReadOptions, reader_for
import sysid.logs.layout, scipy.io, rosbags.rosbag1, lz4.frame
taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (taken + 2**30, taken + 2**30))
for name in sys.argv[1:]:
    path = Path(name)
    try:
        reader_for(path).read(path, ReadOptions())
        print(path.name, "read")
    except InputError as error:
        print(path.name, error)
"""


def test_claims_of_gigabytes_are_refused_where_memory_is_short(tmp_path: Path) -> None:
    bag = original("plain.bag")
    index = int.from_bytes(bag[(at := bag.index(b"index_pos=") + 10) : at + 8], "little")
    files = {
        "index.bag": bag[:index] + b"\xff\xff\xff\x7f" + bag[index + 4 :],
        "huge.mat": original("old.mat")[:4] + b"\xff\xff\xff\x0f\1\0\0\0" + original("old.mat")[12:],
        "huge.blf": original("log.blf")[:152] + b"\xff\xff\xff\x7f" + original("log.blf")[156:],
        "huge.c3d": original("floats.c3d")[:2] + b"\xff\x7f\xff\x7f" + original("floats.c3d")[6:],
    }
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    done = subprocess.run(
        [sys.executable, "-c", CLAIMS, *(str(tmp_path / name) for name in files)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert [line.split()[0] for line in lines] == list(files)
    assert all("expected" in line for line in lines), lines
