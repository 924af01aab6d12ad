"""A few bytes that unpack to very many are refused in every format that unpacks (MCAP and BLF: in their own tests)."""

from __future__ import annotations

import bz2
import struct
import zlib
from pathlib import Path

import pandas as pd
import pytest
from small_logs import ROWS, write_log

from sysid.errors import InputError
from sysid.logs import ReadOptions, reader_for
from sysid.logs.limits import FREE
from sysid.logs.reader import read_confined

ZEROS = bytes(4 * FREE)


def test_a_packed_variable_of_matlab(tmp_path: Path) -> None:
    path = write_log(tmp_path, "packed.mat")
    # A structure of one field, a text: 256 MiB of nothing.
    zeros = bytes(16 * FREE)
    head = struct.pack("<4I", 6, 8, 2, 0) + struct.pack("<2I2i", 5, 8, 1, 1) + struct.pack("<HH4s", 1, 1, b"s")
    names = struct.pack("<HHI", 5, 4, 8) + struct.pack("<2I8s", 1, 8, b"text")
    inner = struct.pack("<4I", 6, 8, 4, 0) + struct.pack("<2I2i", 5, 8, 1, len(zeros)) + struct.pack("<2I", 1, 0)
    inner += struct.pack("<II", 16, len(zeros)) + zeros
    inner = struct.pack("<II", 14, len(inner)) + inner
    matrix = struct.pack("<II", 14, len(head + names + inner)) + head + names + inner
    bomb = zlib.compress(matrix, 9)
    path.write_bytes(path.read_bytes()[:128] + struct.pack("<II", 15, len(bomb)) + bomb)
    with pytest.raises(InputError, match=r"packed\.mat: takes more than \d+ MiB to read"):
        read_confined(reader_for(path), path, ReadOptions())


@pytest.mark.parametrize("stated", [len(ZEROS), 1000])
def test_a_packed_block_of_mdf(tmp_path: Path, stated: int) -> None:
    pytest.importorskip("asammdf", reason="the extra that reads MDF files is not installed")
    path = write_log(tmp_path, "log.mf4")
    data = bytearray(path.read_bytes())
    packed = zlib.compress(ZEROS, 9)
    data += bytes(-len(data) % 8)
    place = len(data)
    data += (
        struct.pack("<4s4xQQ", b"##DZ", 48 + len(packed), 0)
        + struct.pack("<2sBxLQQ", b"DT", 0, 0, stated, len(packed))
        + packed
    )
    group = data.index(b"##DG")
    data[group + 40 : group + 48] = place.to_bytes(8, "little")
    path.write_bytes(bytes(data))
    said = r"more than 1000 times as many" if stated > 1000 else r"more than the 1000 bytes that it states"
    with pytest.raises(InputError, match=rf"log\.mf4: a packed block at byte {place}: .*{said}"):
        reader_for(path).read(path, ReadOptions())


def test_a_packed_mdf_file_is_read(tmp_path: Path) -> None:
    asammdf = pytest.importorskip("asammdf", reason="the extra that reads MDF files is not installed")
    path = write_log(tmp_path, "log.mf4")
    with asammdf.MDF(path) as mdf:
        mdf.save(tmp_path / "packed.mf4", compression=2)
    assert b"##DZ" in (tmp_path / "packed.mf4").read_bytes()
    (stream,) = reader_for(path).read(tmp_path / "packed.mf4", ReadOptions())
    assert len(stream) == ROWS


def test_a_chunk_of_a_bag(tmp_path: Path) -> None:
    path = write_log(tmp_path, "bz2.bag")
    data = path.read_bytes()
    start = data.index(b"BZh")
    size = int.from_bytes(data[start - 4 : start], "little")
    bomb = bz2.compress(ZEROS, 9)
    assert len(bomb) < size
    path.write_bytes(data[:start] + bomb.ljust(size, b"\0") + data[start + size :])
    with pytest.raises(InputError, match=r"bz2\.bag: damaged \(a chunk unpacks to more than 16 MiB"):
        reader_for(path).read(path, ReadOptions())


def test_texts_in_a_parquet_file_are_not_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "log.parquet"
    table = pd.DataFrame({"time": [0.0, 0.1], "x": [1.0, 2.0], "text": ["a" * 10_000_000, "b" * 10_000_000]})
    table.to_parquet(path, compression="zstd")
    assert path.stat().st_size < 100_000
    import pyarrow as pa

    before = pa.default_memory_pool().max_memory()
    (stream,) = reader_for(path).read(path, ReadOptions())
    assert list(stream.columns) == ["x"]
    assert pa.default_memory_pool().max_memory() == before or before > 20_000_000
