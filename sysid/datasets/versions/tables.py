"""Samples and raw channels as Delta tables of one part: written once, addressed by the sha256 of their Parquet files.

Each table has one file for each recording (before it was cut into blocks), so that recordings can be written and read apart.
Parquet with zstd under a Delta log of one commit, readable as either. Units are in the metadata of columns. Missing values are
null.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
import pandas as pd

from sysid.datasets.channel import Channel
from sysid.datasets.chunked import Array, Stamps
from sysid.datasets.recording import Dataset, Recording
from sysid.datasets.versions.files import Files
from sysid.errors import StoreError
from sysid.names import uncut_name
from sysid.progress import Progress, silent
from sysid.progress import part as stretch
from sysid.scratch import empty, leave

if TYPE_CHECKING:
    import pyarrow as pa


#: Rows written at a time, so that a long recording is not copied as a whole.
ROWS = 1 << 20
#: Rows read at a time.
READ_ROWS = 1 << 17


@dataclass(frozen=True)
class PartTables:
    """Paths or URLs of the two Delta tables of some recordings, for other tools."""

    recordings: tuple[str, ...]
    samples: str
    channels: str


def write_samples(files: Files, folder: str, dataset: Dataset, names: Iterable[str], progress: Progress) -> dict[str, Any]:
    """``recording, row, stamp_ns, time`` and one column a signal, one file for each uncut recording; the entry of the manifest.

    Args:
        names: of the uncut recordings.
    """
    groups: dict[str, list[Recording]] = {name: [] for name in names}
    for recording in dataset.recordings:
        groups.setdefault(uncut_name(recording.name, groups), []).append(recording)
    columns = sample_columns(dataset)
    total, done = max(1, sum(map(len, dataset.recordings))), 0
    written = []
    for number, own in enumerate(groups.values()):
        rows = sum(map(len, own))
        share = stretch(progress, done / total, (done + rows) / total)
        written.append(write_sample_file(files, folder, number, own, columns, share))
        done += rows
    return committed(files, folder, written or [write_sample_file(files, folder, 0, [], columns)])


#: Columns of samples: name, NumPy type and SI unit, None for one without.
Columns = Sequence[tuple[str, str, str | None]]


def sample_columns(dataset: Dataset) -> Columns:
    """The columns of all recordings of a dataset."""
    types: dict[str, str] = {}
    for recording in dataset.recordings:
        for column in recording.table.columns:
            types.setdefault(str(column), recording.table[column].to_numpy().dtype.str)
    return [(name, kind, dataset.units.get(name)) for name, kind in types.items()]


def write_sample_file(
    files: Files, folder: str, number: int, recordings: Sequence[Recording], columns: Columns, progress: Progress = silent
) -> dict[str, Any]:
    """File ``number`` of the samples in ``folder``, with the blocks of one recording; its entry of the manifest.

    Args:
        columns: of all files of the table.
    """
    import pyarrow as pa

    fields = [pa.field("recording", pa.string()), pa.field("row", pa.int64()), pa.field("stamp_ns", pa.int64())]
    fields += [pa.field(name, pa.from_numpy_dtype(np.dtype(kind)), metadata=_unit(unit)) for name, kind, unit in columns]
    schema = pa.schema(fields)
    total = max(1, sum(map(len, recordings)))

    def batches() -> Iterator[pa.RecordBatch]:
        done = 0
        for recording in recordings:
            for first in range(0, len(recording), ROWS):
                progress(done / total, f"storing {recording.name}")
                table = recording.table.iloc[first : first + ROWS]
                yield _sample_batch(recording.name, recording.start_ns, table, schema, first)
                done += len(table)

    return _write(files, folder, number, schema, batches())


def _sample_batch(name: str, start_ns: int, table: pd.DataFrame, schema: pa.Schema, first: int) -> pa.RecordBatch:
    import pyarrow as pa

    stamps = start_ns + np.rint(table["time"].to_numpy(dtype=np.float64) * 1e9).astype(np.int64)
    columns = [_repeated(name, len(table)), pa.array(np.arange(first, first + len(table))), pa.array(stamps)]
    for field in list(schema)[3:]:
        if field.name in table.columns:
            columns.append(pa.array(table[field.name].to_numpy(), field.type, from_pandas=True))
        else:
            columns.append(pa.nulls(len(table), field.type))
    return pa.record_batch(columns, schema=schema)


def write_channels(files: Files, folder: str, channels: Mapping[str, Sequence[Channel]], progress: Progress) -> dict[str, Any]:
    """``recording, source, domain, signal, unit, primary, stamp_ns, value``, one file for each recording; the entry of the
    manifest, with the clocks.

    Args:
        channels: recording (before it was cut into blocks) → its channels.
    """
    total, done = max(1, sum(len(c.stamps) for parts in channels.values() for c in parts)), 0
    written = []
    for number, (name, own) in enumerate(channels.items()):
        rows = sum(len(c.stamps) for c in own)
        share = stretch(progress, done / total, (done + rows) / total)
        written.append(write_channel_file(files, folder, number, name, own, share))
        done += rows
    clocks = [clock for name, own in channels.items() for clock in clock_entries(name, own)]
    return {**committed(files, folder, written or [write_channel_file(files, folder, 0, "", ())]), "clocks": clocks}


def clock_entries(recording: str, channels: Sequence[Channel]) -> list[dict[str, str]]:
    """The clock domain of each file of a recording, for the entry of the manifest."""
    clocks = {(recording, c.source, c.domain): None for c in channels}
    return [dict(zip(("recording", "source", "domain"), key, strict=True)) for key in clocks]


def write_channel_file(
    files: Files, folder: str, number: int, recording: str, channels: Sequence[Channel], progress: Progress = silent
) -> dict[str, Any]:
    """File ``number`` of the raw channels in ``folder``: the channels of one recording, one after another."""
    import pyarrow as pa

    texts = [pa.field(name, pa.string()) for name in ("recording", "source", "domain", "signal", "unit")]
    numbers = [pa.field("primary", pa.bool_()), pa.field("stamp_ns", pa.int64()), pa.field("value", pa.float64())]
    schema = pa.schema([*texts, *numbers])
    total = max(1, sum(len(c.stamps) for c in channels))

    def batches() -> Iterator[pa.RecordBatch]:
        done = 0
        for c, rows in ((own, slice(i, i + ROWS)) for own in channels for i in range(0, max(1, len(own.stamps)), ROWS)):
            progress(done / total, f"storing {recording}: {c.signal}")
            stamps, values = c.stamps[rows], c.values[rows]  # noqa: PD011
            done += len(stamps)
            words = [_repeated(text, len(stamps)) for text in (recording, c.source, c.domain, c.signal, c.unit)]
            primary = pa.array(np.full(len(stamps), c.primary))
            numbers = pa.array(values, from_pandas=True)
            yield pa.record_batch([*words, primary, pa.array(stamps), numbers], schema=schema)

    return _write(files, folder, number, schema, batches())


def read_channel_file(files: Files, folder: str, number: int, lengths: Sequence[int]) -> list[tuple[Stamps, Array]]:
    """Stamps [ns] and values of the channels in file ``number``, in their order.

    Args:
        lengths: number of samples of each channel.
    """
    import pyarrow.parquet as pq

    stamps, values = empty(sum(lengths), np.int64), empty(sum(lengths))
    done = 0
    with files.open(f"{folder}/{file_name(number)}") as file:
        for batch in pq.ParquetFile(file).iter_batches(batch_size=READ_ROWS, columns=["stamp_ns", "value"]):
            rows = slice(done, done + len(batch))
            stamps[rows] = batch["stamp_ns"].to_numpy()
            values[rows] = batch["value"].to_numpy(zero_copy_only=False)  # null is NaN
            done = rows.stop
    ends = np.cumsum(lengths).tolist()
    return [(stamps[a:b], values[a:b]) for a, b in zip([0, *ends[:-1]], ends, strict=True)]


def _unit(unit: str | None) -> dict[str, str] | None:
    return {"unit": unit} if unit is not None else None


def _repeated(text: str, count: int) -> pa.Array:
    import pyarrow as pa

    return pa.DictionaryArray.from_arrays(pa.array(np.zeros(count, dtype=np.int32)), [text]).dictionary_decode()


def file_name(number: int) -> str:
    return f"part-{number:05d}.zstd.parquet"


def _write(files: Files, folder: str, number: int, schema: pa.Schema, batches: Iterable[pa.RecordBatch]) -> dict[str, Any]:
    """Write one file, which appears whole; its entry of the manifest."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    texts = [field.name for field in schema if pa.types.is_string(field.type)]
    counted = {field.name: "DELTA_BINARY_PACKED" for field in schema if pa.types.is_integer(field.type)}
    path = f"{folder}/{file_name(number)}"
    with files.replaced(path) as sink:
        # Not pyarrow's own file, so that an error of the disk is an OSError with its number.
        with pq.ParquetWriter(
            sink, schema, compression="zstd", compression_level=3, use_dictionary=texts, column_encoding=counted
        ) as writer:
            for batch in batches:
                writer.write_batch(batch)
                leave()
        sink.flush()
    size, digest = files.address(path)
    return {"path": file_name(number), "size": size, "sha256": digest}


def committed(files: Files, folder: str, written: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The files in ``folder`` as a Delta table of one commit; the entry of the manifest."""
    from deltalake import convert_to_deltalake

    convert_to_deltalake(files.uri(folder), mode="error")
    return {"files": [dict(entry) for entry in written]}


def read_table(
    files: Files,
    part: Mapping[str, Any],
    which: str,
    place: str,
    columns: Sequence[str] | None = None,
    recordings: Collection[str] | None = None,
) -> pa.Table:
    """One table of a part, its files checked against their sha256; only the rows of ``recordings`` where they are named.

    Raises:
        StoreError: a file is missing or was changed.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    wanted = None if columns is None else list(columns)
    rows = None if recordings is None else [("recording", "in", list(recordings))]
    with _undamaged(files, part, which, place):
        tables = [pq.read_table(file, columns=wanted, filters=rows) for file in _opened(files, part, which)]
    return pa.concat_tables(tables, promote_options="default")


def read_batches(
    files: Files, part: Mapping[str, Any], which: str, place: str, columns: Collection[str]
) -> Iterator[pa.RecordBatch]:
    """The rows of :func:`read_table`, :data:`READ_ROWS` at a time, with those of ``columns`` that a file has."""
    import pyarrow.parquet as pq

    with _undamaged(files, part, which, place):
        for file in _opened(files, part, which):
            table = pq.ParquetFile(file, read_dictionary=["recording"], pre_buffer=False)
            wanted = [name for name in table.schema_arrow.names if name in columns]
            yield from table.iter_batches(batch_size=READ_ROWS, columns=wanted, use_threads=False)


def _opened(files: Files, part: Mapping[str, Any], which: str) -> Iterator[BinaryIO]:
    """Each file of a table, checked."""
    for path, expected in _files_of(files, f"{part['folder']}/{which}", part[which]):
        with files.open(path) as file:
            if expected is not None:
                _check(file, expected)
            yield file


@contextmanager
def _undamaged(files: Files, part: Mapping[str, Any], which: str, place: str) -> Iterator[None]:
    """Errors of reading as that of a table.

    Raises:
        StoreError: a file is missing or was changed.
    """
    import pyarrow as pa

    uri = files.uri(f"{part['folder']}/{which}")
    try:
        yield
    except FileNotFoundError as error:
        raise _damaged(place, uri, f"{error.filename or 'a file'} is gone") from None
    except (OSError, ValueError, pa.ArrowException) as error:
        raise _damaged(place, uri, str(error).splitlines()[0]) from None


def is_there(files: Files, part: Mapping[str, Any], which: str) -> bool:
    """Whether the files of a table exist, by their names."""
    if part[which] is None:
        return bool(files.names(f"{part['folder']}/{which}"))
    return {item["path"] for item in part[which]["files"]} <= set(files.names(f"{part['folder']}/{which}"))


def _files_of(files: Files, folder: str, entry: Mapping[str, Any] | None) -> list[tuple[str, Mapping[str, Any] | None]]:
    """Path and address of each Parquet file; the Delta log names them where a manifest of schema 1 does not."""
    if entry is not None:
        return [(f"{folder}/{item['path']}", item) for item in entry["files"]]
    from deltalake import DeltaTable
    from deltalake.exceptions import DeltaError

    try:
        uris = DeltaTable(files.uri(folder), version=0).file_uris()
    except DeltaError as error:
        raise ValueError(str(error)) from None
    return [(f"{folder}/{uri.rpartition('/')[2]}", None) for uri in uris]


def _check(file: BinaryIO, expected: Mapping[str, Any]) -> None:
    import hashlib

    size = file.seek(0, os.SEEK_END)
    if size != expected["size"]:
        raise ValueError(f"{expected['path']} has {size} bytes, {expected['size']} were written")
    file.seek(0)
    if hashlib.file_digest(file, "sha256").hexdigest() != expected["sha256"]:  # type: ignore[arg-type]
        raise ValueError(f"{expected['path']} was changed after it was written: its sha256 differs")
    file.seek(0)


def _damaged(place: str, folder: str, found: str) -> StoreError:
    return StoreError(
        place,
        f"not readable ({found})",
        "the table as written",
        f"Restore {folder}, or ingest the same logs again: they become a new version of the same content.",
    )
