"""Every format with its structure damaged: read, or refused with the name of the file; nothing is misread.

The other half are findings of the fuzzers (``make fuzz``), each made again by hand.
"""

from __future__ import annotations

import re
import sqlite3
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from attempts import attempt
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


@pytest.fixture(scope="module")
def originals(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("originals")
    return {name: write_log(folder, name).read_bytes() for name in LOGS}


def read(path: Path, name: str) -> tuple[tuple[Stream, ...] | None, str]:
    options = ReadOptions(**STATED.get(name, {}))  # type: ignore[arg-type]
    return attempt(InputError, lambda: reader_named(LOGS[name][0], path).read(path, options))


@st.composite
def damage(draw: st.DrawFn, data: bytes) -> bytes:
    """Pieces of the file swapped, repeated, left out, or numbers in it replaced by extreme ones."""
    result = bytearray(data)
    for _ in range(draw(st.integers(1, 3))):
        if not result:
            break
        at, other = (draw(st.integers(0, len(result) - 1)) for _ in range(2))
        size = draw(st.sampled_from([1, 2, 4, 8, 16, 64, 512]))
        match draw(st.sampled_from(["word", "swap", "repeat", "drop", "cut", "zero"])):
            case "word":
                word = draw(st.sampled_from(WORDS))
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


@st.composite
def rewriting(draw: st.DrawFn, data: bytes) -> bytes:
    """Lines of a text swapped, repeated or left out, and cells replaced by what no program should write."""
    lines = [re.split(r"([,;\t ])", line) for line in data.decode("utf-8").splitlines()]
    for _ in range(draw(st.integers(1, 4))):
        if not lines:
            break
        at, other = (draw(st.integers(0, len(lines) - 1)) for _ in range(2))
        place = draw(st.integers(0, max(len(lines[at]) - 1, 0)))
        match draw(st.sampled_from(["cell", "number", "swap lines", "repeat", "drop", "swap cells", "cut"])):
            case "cell" if lines[at]:
                lines[at][place] = draw(st.sampled_from(CELLS))
            case "number":
                places = [i for i, cell in enumerate(lines[at]) if re.fullmatch(r"-?\d+(\.\d+)?", cell)]
                if places:
                    lines[at][draw(st.sampled_from(places))] = draw(st.sampled_from(CELLS))
            case "swap lines":
                lines[at], lines[other] = lines[other], lines[at]
            case "repeat":
                lines.insert(other, list(lines[at]))
            case "drop":
                del lines[at]
            case "swap cells" if lines[at]:
                end = draw(st.integers(0, len(lines[at]) - 1))
                lines[at][place], lines[at][end] = lines[at][end], lines[at][place]
            case "cut":
                del lines[at][place:]
    return "\r\n".join("".join(line) for line in lines).encode("utf-8") + draw(st.sampled_from([b"\r\n", b""]))


def check(path: Path, name: str, data: bytes) -> None:
    path.write_bytes(data)
    streams, refusal = read(path, name)
    assert streams is not None or name in refusal
    for stream in streams or ():
        assert len(stream)
        assert all(len(values) == len(stream) for values in (*stream.columns.values(), *stream.stamps.values()))
    seen = inspect_file(path, LOGS[name][0])
    assert seen.streams or name in seen.refusal


@settings(max_examples=400, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), name=st.sampled_from(sorted(set(LOGS) - {"log.mf4"})))
def test_any_damage_to_any_format_ends_in_streams_or_a_reason(
    tmp_path: Path, originals: dict[str, bytes], data: st.DataObject, name: str
) -> None:
    text = Path(name).suffix in TEXT
    damaged = data.draw((rewriting if text and data.draw(st.booleans()) else damage)(originals[name]))
    check(tmp_path / name, name, damaged)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_damage_to_mdf_ends_in_streams_or_a_reason(
    tmp_path: Path, originals: dict[str, bytes], data: st.DataObject
) -> None:
    check(tmp_path / "log.mf4", "log.mf4", data.draw(damage(originals["log.mf4"])))


@pytest.mark.parametrize("name", sorted(LOGS))
def test_a_file_that_is_cut_off_gives_no_other_numbers(tmp_path: Path, originals: dict[str, bytes], name: str) -> None:
    """What is read of a part is the beginning of what is read of the whole."""
    whole_path, part_path = tmp_path / "whole" / name, tmp_path / "part" / name
    for path in (whole_path, part_path):
        path.parent.mkdir()
    whole_path.write_bytes(originals[name])
    streams, _ = read(whole_path, name)
    whole = {stream.name: stream for stream in streams or ()}
    assert whole
    for share in (0.3, 0.5, 0.7, 0.9, 0.97):
        part_path.write_bytes(originals[name][: int(share * len(originals[name]))])
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


def test_claims_of_gigabytes_are_refused_where_memory_is_short(tmp_path: Path, originals: dict[str, bytes]) -> None:
    bag = originals["plain.bag"]
    index = int.from_bytes(bag[(at := bag.index(b"index_pos=") + 10) : at + 8], "little")
    files = {
        "index.bag": bag[:index] + b"\xff\xff\xff\x7f" + bag[index + 4 :],
        "huge.mat": originals["old.mat"][:4] + b"\xff\xff\xff\x0f\1\0\0\0" + originals["old.mat"][12:],
        "huge.c3d": originals["floats.c3d"][:2] + b"\xff\x7f\xff\x7f" + originals["floats.c3d"][6:],
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
