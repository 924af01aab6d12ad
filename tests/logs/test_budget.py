"""Small files that ask for much: each is refused by its reader, and costs little memory (measured in a process of its own)."""

from __future__ import annotations

import os
import re
import sqlite3
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import zstandard
from small_logs import write_log

from sysid.confined import confined
from sysid.datasets.discover import discover
from sysid.datasets.recipe import NO_RECIPE
from sysid.errors import InputError
from sysid.logs import ReadOptions, reader_for, reader_named
from sysid.logs.inspection import inspect_file
from sysid.logs.limits import Budget

MIB = 2**20
#: What a regression may take before it fails: the machine is not filled.
LOOSE = Budget(memory=1024 * MIB, seconds=60.0, chunk=MIB, unpacked=MIB, rows=1)
#: A refusal may cost so much memory beside what the process had.
MOST = 300 * MIB


def resident(key: str) -> int:
    """``VmHWM`` (the most so far) or ``VmRSS`` (now) of this process [B]."""
    found = re.search(rf"{key}:\s+(\d+) kB", Path("/proc/self/status").read_text())
    assert found is not None
    return int(found[1]) * 1024


def refusal(path: Path, reader: str | None, options: ReadOptions) -> tuple[str, int]:
    """How the file is refused, and the memory that took [B]."""

    def work(report: Callable[[float], None]) -> tuple[str, int]:
        before = resident("VmRSS")
        try:
            (reader_named(reader, path) if reader else reader_for(path)).read(path, options)
        except InputError as error:
            return str(error), resident("VmHWM") - before
        return "", resident("VmHWM") - before

    return confined(work, path, LOOSE.limits, ())


def generated_column(path: Path) -> None:
    write_log(path.parent, "log.db3")
    with sqlite3.connect(path.with_name("log.db3")) as database:
        database.execute("ALTER TABLE messages RENAME COLUMN data TO stored")
        database.execute("ALTER TABLE messages ADD COLUMN data BLOB GENERATED ALWAYS AS (zeroblob(800000000))")
    database.close()
    path.with_name("log.db3").rename(path)


def view_of_topics(path: Path) -> None:
    write_log(path.parent, "log.db3")
    with sqlite3.connect(path.with_name("log.db3")) as database:
        database.execute("CREATE VIEW message_definitions AS WITH r(n) AS (SELECT 1 UNION ALL SELECT n FROM r) SELECT n FROM r")
    database.close()
    path.with_name("log.db3").rename(path)


def wide_table(path: Path) -> None:
    path.write_text("time," + ",".join(f"c{i}" for i in range(60_000)) + "\n" + ("0" + ",1" * 60_000 + "\n") * 3)


def long_line(path: Path) -> None:
    path.write_bytes(b"x" * (5 * MIB))


def list_in_a_cell(path: Path) -> None:
    path.write_text("time,q\n" + '0,"[' + "1," * 300_000 + '1]"\n')


def packed_messages(path: Path) -> None:
    """A chunk of half a megabyte with 500 MB of the shortest messages, behind one with noise."""
    noise = np.random.default_rng(1).bytes(MIB // 2)
    first = struct.pack("<BQHIQQ", 5, 22 + len(noise), 1, 0, 0, 0) + noise
    piece, times = struct.pack("<BQHIQQ", 5, 22, 1, 0, 0, 0) * 32_768, 490
    size = len(first) + times * len(piece)
    packer = zstandard.ZstdCompressor(level=1).compressobj(size=size)
    packed = packer.compress(first) + b"".join(packer.compress(piece) for _ in range(times)) + packer.flush()
    head = struct.pack("<QQQII", 0, 1, size, 0, 4) + b"zstd" + struct.pack("<Q", len(packed))
    schema = struct.pack("<HII", 1, 0, 0) + struct.pack("<I", 0)
    channel = struct.pack("<HH", 1, 0) + struct.pack("<I2sI4s", 2, b"/a", 4, b"json") + struct.pack("<I", 0)
    data = b"\x89MCAP0\r\n"
    for opcode, body in ((3, schema), (4, channel), (6, head + packed), (15, b"\0\0\0\0")):
        data += struct.pack("<BQ", opcode, len(body)) + body
    path.write_bytes(data)


def many_topics(path: Path) -> None:
    data = [b"\x89MCAP0\r\n"]
    for number in range(20_000):
        topic = f"/t{number}".encode()
        body = struct.pack(f"<HHI{len(topic)}sI4sI", number, 0, len(topic), topic, 4, b"json", 0)
        data.append(struct.pack("<BQ", 4, len(body)) + body)
    path.write_bytes(b"".join(data) + struct.pack("<BQ", 15, 4) + bytes(4))


def tabs(path: Path) -> None:
    lines = ["PathFileType\t4\t(X/Y/Z)\tx.trc", "DataRate\tUnits", "10\tmm", "Frame#\tTime\ttip\t\t", "\t\tX1\tY1\tZ1", ""]
    path.write_text("\n".join([*lines, "1\t0\t1\t2\t3", "\t" * 3_000_000]) + "\n")


def empty_objects(path: Path) -> None:
    path.write_bytes(b'[{"a": [' + b"{}," * 3_000_000 + b"{}]}]")


def constant_columns(path: Path) -> None:
    values = np.zeros(2**20)
    with pq.ParquetWriter(path, pa.schema([("time", pa.float64())]), compression="zstd") as writer:
        for _ in range(40):
            writer.write_table(pa.table({"time": values}))


def packed_variable(path: Path) -> None:
    """40 million zeros as numbers of one byte."""
    count = 40 * MIB
    head = struct.pack("<4I", 6, 8, 6, 0) + struct.pack("<2I2i", 5, 8, 1, count) + struct.pack("<HH4s", 1, 1, b"t")
    head += struct.pack("<2I", 2, count)
    packer = zlib.compressobj(1)
    packed = packer.compress(struct.pack("<2I", 14, len(head) + count) + head)
    packed += b"".join(packer.compress(bytes(MIB)) for _ in range(40)) + packer.flush()
    file_head = b"MATLAB 5.0".ljust(124) + struct.pack("<H2s", 0x100, b"IM")
    path.write_bytes(file_head + struct.pack("<2I", 15, len(packed)) + packed)


def one_body_a_frame(path: Path) -> None:
    frames = "".join(f"frame,{i},{i},1,{i},0,0,0,0,0,0,1,0,0,0,0\n" for i in range(20_000))
    path.write_text("info,version,1.1\n" + frames)


def many_sections(path: Path) -> None:
    path.write_text("Devices\n10\n,,a\nFrame,Sub Frame,V\n,,V\n1,0,1\n\n" * 200)


BOMBS: dict[str, tuple[str | None, Callable[[Path], None], str]] = {
    "generated.db3": (None, generated_column, r"table 'messages': a generated column 'data'; expected rows that rosbag2"),
    "view.db3": (None, view_of_topics, r"table 'message_definitions': a view; expected rows that rosbag2 has stored"),
    "wide.csv": (None, wide_table, r"60001 columns; expected at most 16384 columns"),
    "line.csv": (None, long_line, r"a line of more than 4194304 letters; expected one header row"),
    "list.csv": (None, list_in_a_cell, r"list.csv: q: 300001 elements of a list; expected at most 16384"),
    "chunk.mcap": (None, packed_messages, r"unpacks to 475 MiB, more than 64 MiB"),
    "topics.mcap": (None, many_topics, r"4097 topics; expected at most 4096 topics. Name those that are needed in the recipe"),
    "tabs.trc": (None, tabs, r"3000000 cells in a row; expected at most 16384 cells in a row"),
    "objects.json": ("json", empty_objects, r"values that take 947 MiB; expected at most 549 MiB"),
    "constant.parquet": (None, constant_columns, r"41943040 numbers; expected at most 33554432 numbers"),
    "packed.mat": (None, packed_variable, r"41943040 numbers; expected at most 33554432 numbers"),
    "frames.csv": ("motive", one_body_a_frame, r"4097 rigid bodies and markers; expected at most 4096"),
    "sections.csv": (None, many_sections, r"more than 64 sections; expected one for each kind"),
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_small_file_that_asks_for_much_is_refused_at_little_cost(name: str, tmp_path: Path) -> None:
    reader, write, said = BOMBS[name]
    path = tmp_path / name
    write(path)
    assert path.stat().st_size < 12 * MIB
    text, taken = refusal(path, reader, ReadOptions(length_unit="m" if name == "frames.csv" else None))
    assert re.search(said, text), text
    assert str(path) in text
    assert taken < MOST


@pytest.mark.parametrize("suffix", [".csv", ".mcap", ".mat", ".parquet", ".db3", ".bag", ".c3d", ".blf", ".mf4", ".trc"])
def test_what_is_no_file_is_not_opened(suffix: str, tmp_path: Path) -> None:
    pipe, link = tmp_path / f"pipe{suffix}", tmp_path / f"link{suffix}"
    os.mkfifo(pipe)
    link.symlink_to("/dev/zero")
    for path, what in ((pipe, "a named pipe"), (link, "a device")):
        with pytest.raises(InputError, match=rf"{path.name}: {what}; expected .*Copy the log into a file"):
            reader_for(path).read(path, ReadOptions())
        assert what in inspect_file(path).refusal
        with pytest.raises(InputError, match=rf"{path.name}: {what}; expected a log file or a folder of recordings"):
            discover([path], NO_RECIPE)
