"""An sqlite file of unknown origin: all that belongs to it is read, nothing of it is changed, and nothing in it is computed."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

from sysid import scratch
from sysid.errors import InputError, StorageError
from sysid.logs.limits import Budget, check_file

#: Tables of an sqlite file that the library reads.
_TABLES = ("topics", "messages", "schema", "message_definitions", "metadata")


def side_files(path: Path) -> tuple[Path, ...]:
    """The write-ahead log beside an sqlite bag, which is a part of it; none beside other logs."""
    log = Path(f"{path.resolve()}-wal")
    return (log,) if log.exists() and log.stat().st_size else ()


@contextlib.contextmanager
def whole_database(path: Path, budget: Budget) -> Iterator[Path]:
    """An sqlite file that holds all messages: ``path``, or a private copy into which its write-ahead log has been moved.

    sqlite merges the log only into a file that it may write, and a file of the user is not changed. The copy can be deleted
    once it is open.

    Raises:
        InputError: a transaction was interrupted, or the log is no file.
        StorageError: the copy has no room.
    """
    import apsw

    _check_journal(path)
    logs = side_files(path)
    if not logs:
        yield path
        return
    for log in logs:
        if log.is_symlink():
            raise InputError(log, "a link", "the write-ahead log of an sqlite file", "Copy the file beside the bag.")
        check_file(log, "the write-ahead log of an sqlite file")
    own = scratch.current()
    with tempfile.TemporaryDirectory(prefix=".bag-", dir=None if own is None else own.folder) as folder:
        copy = Path(folder) / "bag.db3"
        try:
            shutil.copyfile(path, copy)
            for log in logs:
                shutil.copyfile(log, f"{copy}-wal")
            with limited_rows(budget), contextlib.closing(apsw.Connection(str(copy), apsw.SQLITE_OPEN_READWRITE)) as database:
                database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        except apsw.Error as error:
            raise InputError(path, f"not readable as rosbag2 ({short(error)})", "an sqlite file that rosbag2 wrote") from None
        except PermissionError:
            raise
        except OSError as error:
            found = f"no room for a copy of {path.name} with its write-ahead log ({os.strerror(error.errno or 0)})"
            remedy = f'Merge it in its place: sqlite3 {path.name} "PRAGMA wal_checkpoint(TRUNCATE)".'
            raise StorageError(folder, found, f"{path.stat().st_size / 2**20:.0f} MiB", remedy) from None
        yield copy


#: First bytes of the journal of a transaction that can be undone.
_JOURNAL_MAGIC = bytes.fromhex("d9d505f920a163d7")


def _check_journal(path: Path) -> None:
    """Raise where a transaction of an sqlite file was interrupted: its pages are partly those of before, partly those of after.

    Source: SQLite, "Database File Format", 3. The journal may name other files, which sqlite deletes, so it is not rolled back.
    """
    journal = Path(f"{path.resolve()}-journal")
    if not journal.is_file():
        return
    with journal.open("rb") as file:
        if file.read(len(_JOURNAL_MAGIC)) != _JOURNAL_MAGIC:
            return
    remedy = f'Undo it with sqlite, best in a copy of both files: sqlite3 {path.name} "PRAGMA integrity_check".'
    raise InputError(path, f"a transaction that was interrupted ({journal.name})", "a complete sqlite file", remedy)


def check_pages(path: Path, database: Path) -> None:
    """Raise where an sqlite file is shorter than it states: missing pages would be read as zeros.

    Source: SQLite, "Database File Format", 1.3.8 (the size is valid where the counter behind it agrees).
    """
    with database.open("rb") as file:
        head = file.read(100)
    if len(head) < 100 or not head.startswith(b"SQLite format 3\0"):
        return  # reported when it is opened
    page, pages = int.from_bytes(head[16:18], "big"), int.from_bytes(head[28:32], "big")
    size, there = (65536 if page == 1 else page) * pages, database.stat().st_size
    if head[24:28] == head[92:96] and size > there:
        remedy = f"Save what is left: sqlite3 {path.name} .recover | sqlite3 recovered.db3"
        raise InputError(path, f"the file is cut off: {there} of {size} bytes", "a whole sqlite file", remedy)


@contextlib.contextmanager
def limited_rows(budget: Budget) -> Iterator[None]:
    """Limits values of databases that are opened within the context to the size of a chunk."""
    import apsw

    def limit(database: apsw.Connection) -> None:
        database.limit(apsw.SQLITE_LIMIT_LENGTH, budget.chunk)

    apsw.connection_hooks.append(limit)
    try:
        yield
    finally:
        apsw.connection_hooks.remove(limit)


def check_tables(path: Path, file: Path) -> None:
    """Raise where the tables of a bag are computed when they are read: views, virtual tables, generated columns.

    Raises:
        InputError: a table that is not stored.
        apsw.Error: no sqlite file.
    """
    import apsw

    database = apsw.Connection(f"file:{quote(str(file))}?immutable=1", apsw.SQLITE_OPEN_READONLY | apsw.SQLITE_OPEN_URI)
    with contextlib.closing(database):
        for name in _TABLES:
            kinds = [
                kind for (kind,) in database.execute("SELECT type FROM pragma_table_list WHERE name = ? COLLATE NOCASE", [name])
            ]
            hidden = [row[1] for row in database.execute("SELECT * FROM pragma_table_xinfo(?)", [name]) if row[6]]
            found = "" if set(kinds) <= {"table"} else f"a {kinds[0]}" if kinds != ["virtual"] else "a virtual table"
            found = found or (f"a generated column {hidden[0]!r}" if hidden else "")
            if found:
                where = f"{path}: table {name!r}"
                raise InputError(where, found, "rows that rosbag2 has stored", "The file is damaged or malicious.")


def short(error: Exception) -> str:
    """The first line of an error of a library."""
    return (str(error).splitlines() or [""])[0][:160] or type(error).__name__
