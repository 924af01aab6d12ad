"""Throws damaged bytes at the readers, and at whatever else strangers can hand over, guided by the code they reach.

``make fuzz`` runs it (atheris, an extra: ``sysid[fuzz]``).

    python tests/fuzz/fuzz_readers.py [READER | TARGET …] [--seconds 120] [--work FOLDER]

Targets beside the readers are those of ``targets.py``: workspaces, registry rows, machines, URDFs, MJCFs, recipes, names;
and those of ``whole_verbs.py``: edges of numbers, names in exports, watched folders, stored results, the current folder.
Each runs in a process of its own, starting from the small logs of its format or from what the project ships, and ends early
with the first input that raises anything but an error of ``sysid.errors``, takes longer than 20 s, or needs more than 1 GiB
beside the libraries. It is kept in ``FOLDER/<reader>/crash-…``; `--again FILE` reads it once more, in the open.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from targets import TARGETS, forget

# As where files are read: the other pools reserve a gigabyte of address space at once. Read when pyarrow is imported.
os.environ["ARROW_DEFAULT_MEMORY_POOL"] = "system"
ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "rl"), str(ROOT / "tests" / "helpers")]

LARGEST_INPUT = 16 * 1024
#: For one input: seconds, and memory beyond what the process takes before it.
SECONDS_EACH, MEMORY = 20, 2**30
#: Not a file format: one message of a type that the input describes, read by the layout that another message taught.
MESSAGE = "message"


def read_file(path: Path, reader: str, options: Any) -> None:
    """Read and inspect; every stream is as long as its stamps."""
    from sysid.errors import InputError
    from sysid.logs import reader_named
    from sysid.logs.inspection import inspect_here

    try:
        streams, refusal = reader_named(reader, path).read(path, options), path.name
    except InputError as error:
        streams, refusal = (), str(error)
    assert path.name in refusal, f"the message does not name the file: {refusal}"
    for stream in streams:
        assert all(len(values) == len(stream) for values in (*stream.columns.values(), *stream.stamps.values()))
    inspect_here(path, reader_named(reader, path))  # not in a process of its own: what it reaches is seen here


def read_message(data: bytes) -> None:
    """``definition \\0 message``: walked or refused; its numbers lie inside of it."""
    from sysid.errors import InputError
    from sysid.logs.layout import layout_of
    from sysid.logs.rosmsg import parse_definition

    text, _, body = data.partition(b"\0")
    try:
        definition = parse_definition("p/msg/M", text.decode("utf-8", errors="replace"), "input")
    except InputError:
        return
    for packed in (False, True):
        try:
            layout = layout_of(body, definition, packed=packed)
        except IndexError:
            continue
        for code, position in layout.numbers.values():
            assert 0 <= position <= len(body) - int(code[2])


def fuzz(reader: str, corpus: Path, seconds: int) -> None:
    """Run in this process; libFuzzer ends it."""
    import atheris

    if reader in TARGETS:
        with atheris.instrument_imports(include=["sysid", "sysid_rl"], exclude=compiled_modules()):
            for seed in TARGETS[reader].seeds():  # whatever it imports
                TARGETS[reader].run(seed)
        _run(TARGETS[reader].run, corpus, seconds)
        return
    with atheris.instrument_imports(include=["sysid.logs"]):
        from sysid.logs import ReadOptions
        from sysid.logs.inspection import inspect_here  # noqa: F401
    from small_logs import LOGS, STATED

    names = [name for name, (kind, _) in LOGS.items() if kind == reader]
    suffixes = {name: Path(name).suffix for name in names}
    folder = Path(tempfile.mkdtemp(dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    target: Callable[[bytes], None]
    if reader == MESSAGE:
        target = read_message
    else:
        stated = ReadOptions(**{key: value for name in names for key, value in STATED.get(name, {}).items()})  # type: ignore[arg-type]
        kinds = sorted(set(suffixes.values()))

        def target(data: bytes) -> None:
            # CAN logs of four kinds share a reader: the content decides, as far as it says so.
            suffix = next((suffixes[name] for name in names if data[:4] == heads[name]), kinds[0])
            path = folder / f"input{suffix}"
            path.write_bytes(data)
            read_file(path, reader, ReadOptions() if reader == "motive" and b"Length Units" in data else stated)

        heads = {path.name: path.read_bytes()[:4] for path in corpus.iterdir() if path.name in suffixes}
    _run(target, corpus, seconds)


def compiled_modules() -> list[str]:
    """Modules with functions that numba compiles: it cannot compile calls of the instrumentation."""
    found = [
        path.relative_to(folder)
        for folder, package in ((ROOT, "sysid"), (ROOT / "rl", "sysid_rl"))
        for path in (folder / package).rglob("*.py")
        if re.search(r"^from sysid\S*\.compiled import", path.read_text("utf-8"), re.M)
    ]
    return [".".join(path.with_suffix("").parts) for path in found]


def _run(target: Callable[[bytes], None], corpus: Path, seconds: int) -> None:
    import atheris

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

    def limited(data: bytes) -> None:
        """The instrumentation of compiled templates and modules grows from input to input, and counts for none."""
        taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (taken + MEMORY, resource.RLIM_INFINITY))
        target(data)

    limits = [
        f"-max_total_time={seconds}",
        f"-timeout={SECONDS_EACH}",
        "-rss_limit_mb=0",
        f"-max_len={LARGEST_INPUT}",
    ]
    atheris.Setup([sys.argv[0], *limits, f"-artifact_prefix={corpus}/", "-print_final_stats=1", str(corpus)], limited)
    atheris.Fuzz()


def seeds(reader: str, corpus: Path) -> None:
    """The first inputs."""
    from small_logs import LOGS, write_log

    corpus.mkdir(parents=True, exist_ok=True)
    if reader in TARGETS:
        for number, seed in enumerate(TARGETS[reader].seeds()):
            (corpus / f"seed-{number}").write_bytes(seed)
        forget()
        return
    if reader == MESSAGE:
        line = "=" * 80
        (corpus / "seed").write_bytes(
            f"string[] name\nfloat64[] position\nI i\nuint8[4] raw\n{line}\nMSG: p/I\nint16 a\nstring s\n".encode()
            + b"\0\0\1\0\0\1\0\0\0\2\0\0\0a\0\0\0\1\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\1\0\0\0\0\0\0\0\1\2\3\4"
        )
        return
    for name, (kind, _) in LOGS.items():
        if kind == reader and not (corpus / name).exists():
            write_log(corpus, name)


def main() -> int:
    from small_logs import LOGS

    readers = [*dict.fromkeys(kind for kind, _ in LOGS.values()), MESSAGE, *TARGETS]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("readers", nargs="*", help=f"of {', '.join(readers)}; default: all")
    parser.add_argument("--seconds", type=int, default=120, help="for each reader")
    parser.add_argument("--work", type=Path, default=Path("workspace/fuzz"), help="inputs that reached new code, and findings")
    parser.add_argument("--again", type=Path, help="read this input of one reader again")
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    chosen = given.readers or readers
    if unknown := set(chosen) - set(readers):
        parser.error(f"no reader {', '.join(sorted(unknown))}; one of {', '.join(readers)}")
    if given.here:
        fuzz(chosen[0], given.work.resolve() / chosen[0], given.seconds)
        return 0
    if given.again is not None:
        from sysid.logs import ReadOptions

        if chosen[0] in TARGETS:
            TARGETS[chosen[0]].run(given.again.read_bytes())
            forget()
        elif chosen[0] == MESSAGE:
            read_message(given.again.read_bytes())
        else:
            read_file(given.again, chosen[0], ReadOptions())
        return 0
    failed = []
    for reader in chosen:
        seeds(reader, given.work / reader)
        command = [sys.executable, __file__, reader, "--here", "--work", str(given.work), "--seconds", str(given.seconds)]
        log = given.work / f"{reader}.log"
        with log.open("w") as out:
            status = subprocess.run(command, stdout=out, stderr=subprocess.STDOUT, check=False).returncode
        runs = [line.split()[-1] for line in log.read_text(errors="replace").splitlines() if "number_of_executed_units" in line]
        print(
            f"{reader}: {runs[0] if runs else '?'} inputs, {'nothing found' if not status else f'FOUND: see {log}'}", flush=True
        )
        failed += [reader] if status else []
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
