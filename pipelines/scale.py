"""Ingest and gap on 1, 2 and 4 worker processes of a Dask cluster on this machine: time, overhead a task, bytes moved, faults.

    python pipelines/scale.py --work workspace/scale --publish

The logs are the motion recordings of the demo, repeated under other names. Every version is compared with that of one process,
to the byte. The growth with the number of recordings is measured on two processes, and what 100 machines would cost follows on
paper (scaling/estimate.py). ``--publish`` writes ``reports/scale/result.json`` and the tables of ``reports/bench/README.md``.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import signal
import socket
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from committed import ROOT, markdown, provenance, write_result, write_tables
from scaling.estimate import CORES, HEAD, MACHINES, RAW_BYTES, estimate_rows, exponent
from scaling.gap import HEAD as GAP_HEAD
from scaling.gap import gap_rows, table_rows
from scaling.loopback import HOST, commands, running
from scaling.measured_executor import MeasuredExecutor, nothing
from sysid.datasets import Dataset, Store, ingest
from sysid.execution import Executor, LocalExecutor
from sysid.execution.cluster import ClusterExecutor

DEMO = ROOT / "datasets/autolog"
RESULT, PAGE = ROOT / "reports/scale/result.json", ROOT / "reports/bench/README.md"
#: Empty tasks for the overhead of one, and the time to wait for workers [s].
EMPTY, START_S = 200, 300.0
#: Recordings of the gap.
SEARCHED = 6
#: Share of the ingest after which a worker is killed.
KILLED_AT = 0.4
#: Entries of a manifest that differ between two versions of the same content.
VARYING = ("created", "folder")


def write_logs(folder: Path, count: int) -> Path:
    """``count`` recordings of motion: those of the demo, again and again."""
    shutil.rmtree(folder, ignore_errors=True)
    motion = sorted((DEMO / "logs").glob("manual-*"))
    folder.mkdir(parents=True)
    for name in ("machine.toml", "autolog.urdf"):
        shutil.copy(DEMO / name, folder)
    recipe = (DEMO / "recipe.toml").read_text("utf-8")
    last = f"manual-{count - 1:04d}"
    (folder / "recipe.toml").write_text(recipe.replace('"manual-06"', f'"{last}"'), "utf-8")
    for k in range(count):
        shutil.copytree(motion[k % len(motion)], folder / "logs" / f"manual-{k:04d}")
    return folder


def content(store: Store, reference: str) -> Any:
    """What two versions of the same content have in common; it includes the sha256 of every table."""

    def without(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: without(own) for key, own in value.items() if key not in VARYING}
        return [without(own) for own in value] if isinstance(value, list) else value

    return without(store.manifest(reference))


@contextmanager
def cluster(workers: int) -> Iterator[tuple[ClusterExecutor, list[int]]]:
    """An executor on a cluster of its own with all its workers, and the process ids of the workers' parents."""
    from distributed import Client

    with socket.socket() as probe:
        probe.bind((HOST, 0))
        port = probe.getsockname()[1]
    with tempfile.TemporaryFile() as log, running(commands(workers, port), log) as processes:
        executor = ClusterExecutor(f"tcp://{HOST}:{port}", START_S)
        with Client(executor.address, timeout=START_S, set_as_default=False) as client:
            client.wait_for_workers(workers, timeout=START_S)
        yield executor, [process.pid for process in processes[1:]]


def measured(logs: Path, work: Path, executor: Executor, workers: int, where: str, expected: Any) -> dict[str, Any]:
    """A row: an ingest after one whose time does not count, so that every process has imported what it needs."""
    own = MeasuredExecutor(executor)
    with executor.kept() as kept:
        kept.run(nothing, [(k,) for k in range(4 * workers)])
        begin = time.perf_counter()
        kept.run(nothing, [(k,) for k in range(EMPTY)])
        empty = (time.perf_counter() - begin) / EMPTY
        ingest(logs, fresh(work), executor=kept)
        workspace = fresh(work)
        found, seconds = timed_ingest(logs, workspace, MeasuredExecutor(kept, own.measures))
    return {
        "where": where,
        "workers": workers,
        "seconds": seconds,
        "tasks": own.measures.tasks,
        "task_seconds": own.measures.seconds,
        "caller_seconds": seconds - own.measures.waited,
        "overhead_s": empty,
        "sent_bytes": own.measures.sent,
        "returned_bytes": own.measures.returned,
        "same_result": content(Store(workspace), found.reference) == expected,
    }


def killed_worker(logs: Path, work: Path, workers: int, expected: Any) -> dict[str, Any]:
    """A row: a worker is killed in mid-ingest."""
    workspace = fresh(work)
    with cluster(workers) as (executor, parents):
        killed: list[int] = []

        def progress(share: float, text: str) -> None:
            if share > KILLED_AT and not killed:
                killed.append(int(Path(f"/proc/{parents[0]}/task/{parents[0]}/children").read_text().split()[0]))
                os.kill(killed[0], signal.SIGKILL)

        found = ingest(logs, workspace, progress=progress, executor=executor)
    if not killed:
        raise RuntimeError("no worker was killed: too few recordings")
    return {"fault": "worker killed in mid-ingest", "same_result": content(Store(workspace), found.reference) == expected}


def growth(work: Path, counts: Sequence[int]) -> list[dict[str, Any]]:
    """Rows by the number of recordings, on two processes: time of the ingest, of the caller, and of a listing afterwards."""
    rows = []
    for count in counts:
        logs = write_logs(work / "growth", count)
        own = MeasuredExecutor(LocalExecutor(2))
        with own.executor.kept() as kept:
            kept.run(nothing, [(k,) for k in range(8)])
            workspace = fresh(work)
            found, seconds = timed_ingest(logs, workspace, MeasuredExecutor(kept, own.measures))
        begin = time.perf_counter()
        store = Store(workspace)
        if found.reference not in {f"{entry.name}@{entry.version}" for entry in store.list()}:
            raise RuntimeError("the version that was written is not listed")
        listed = time.perf_counter() - begin
        begin = time.perf_counter()
        dataset = store.load(found.reference)
        loaded = time.perf_counter() - begin
        if len(dataset.recordings) != count:
            raise RuntimeError(f"{len(dataset.recordings)} recordings were loaded of {count}")
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
        rows.append(
            {
                "recordings": count,
                "seconds": seconds,
                "caller_seconds": seconds - own.measures.waited,
                "list_seconds": listed,
                "load_seconds": loaded,
                "peak_bytes": peak,
            }
        )
        sys.stderr.write(f"{count} recordings: {seconds:.1f} s\n")
    return rows


def gap_of_few(work: Path, counts: Sequence[int]) -> list[dict[str, Any]]:
    """Rows of :func:`gap_rows` for :data:`SEARCHED` recordings."""
    shutil.rmtree(work / "searched", ignore_errors=True)
    dataset = ingest(write_logs(work / "few", SEARCHED), work / "searched")
    return gap_rows(work / "searched", dataset.reference, counts, cluster)


def timed_ingest(logs: Path, workspace: Path, executor: Executor) -> tuple[Dataset, float]:
    """The dataset, and the seconds that its ingest took."""
    begin = time.perf_counter()
    found = ingest(logs, workspace, executor=executor)
    return found, time.perf_counter() - begin


def fresh(work: Path) -> Path:
    """An empty workspace."""
    shutil.rmtree(work / "workspace", ignore_errors=True)
    return work / "workspace"


def study(work: Path, counts: Sequence[int], recordings: int, growing: Sequence[int]) -> dict[str, Any]:
    """All figures."""
    grown = growth(work, growing)
    logs = write_logs(work / "logs", recordings)
    shutil.rmtree(work / "alone", ignore_errors=True)
    ingest(logs, work / "alone")
    shutil.rmtree(work / "alone")
    begin = time.perf_counter()
    alone = ingest(logs, work / "alone")
    seconds = time.perf_counter() - begin
    expected = content(Store(work / "alone"), alone.reference)
    rows: list[dict[str, Any]] = []
    for workers in counts:
        rows.append(measured(logs, work, LocalExecutor(workers), workers, "processes", expected))
        with cluster(workers) as (executor, _):
            rows.append(measured(logs, work, executor, workers, "cluster", expected))
        times = [f"{row['seconds']:.1f} s" for row in rows[-2:]]
        sys.stderr.write(f"{workers} workers: {times[0]} in processes, {times[1]} on a cluster\n")
    (part,) = Store(work / "alone").tables(alone.reference)
    tables = sum(file.stat().st_size for place in (part.samples, part.channels) for file in Path(place).glob("*.parquet"))
    return {
        "settings": {
            "recordings": recordings,
            "cores": os.cpu_count(),
            "seconds": sum(float(r.table["time"].iloc[-1]) for r in alone.recordings),
        },
        "alone": {"seconds": seconds},
        "bytes": {"raw": sum(source.size for source in alone.sources), "tables": tables},
        "rows": rows,
        "gap": gap_of_few(work, counts),
        "growth": grown,
        "faults": [killed_worker(logs, work, 2, expected)],
    }


def tables(result: dict[str, Any]) -> str:
    """Tables of the page."""
    alone, count = result["alone"]["seconds"], result["settings"]["recordings"]
    rows = [("one process, without tasks", "1", f"{alone:.1f}", "1.00", "", "", "", "")]
    for row in result["rows"]:
        waiting = (row["seconds"] * row["workers"] - row["task_seconds"]) / max(1, row["tasks"])
        rows.append(
            (
                {"processes": "processes of this machine", "cluster": "Dask cluster on loopback"}[row["where"]],
                str(row["workers"]),
                f"{row['seconds']:.1f}",
                f"{alone / row['seconds']:.2f}",
                f"{1e3 * row['overhead_s']:.1f}",
                f"{1e3 * waiting:.0f}",
                f"{row['sent_bytes'] / count / 1e3:.0f}",
                f"{row['returned_bytes'] / count / 1e3:.0f}",
            )
        )
    measured_on = ("where", "workers", "ingest [s]", "speed-up", "empty task [ms]", "a worker waits, by task [ms]")
    head = (*measured_on, "sent, by recording [kB]", "returned, by recording [kB]")
    same = sum(row["same_result"] for row in result["rows"])
    bytes_of = result["bytes"]
    words = (
        f"{count} recordings with {bytes_of['raw'] / 1e6:.1f} MB of raw files, which become "
        f"{bytes_of['tables'] / 1e6:.1f} MB of tables; "
        f"{result['settings']['cores']} cores; {result['machine']}; commit {result['commit']}. "
        f"The version is that of one process, to the byte, in {same} of {len(result['rows'])} runs."
    )
    grown = result["growth"]
    counts = [row["recordings"] for row in grown]
    growth_rows = [
        (
            str(row["recordings"]),
            f"{row['seconds']:.1f}",
            f"{row['caller_seconds']:.2f}",
            f"{1e3 * row['list_seconds']:.1f}",
            f"{row['load_seconds']:.2f}",
            f"{row['peak_bytes'] / 1e6:.0f}",
        )
        for row in grown
    ]
    keys = ("seconds", "caller_seconds", "list_seconds", "load_seconds", "peak_bytes")
    growth_rows.append(("exponent", *(f"{exponent(counts, [row[key] for row in grown]):.2f}" for key in keys)))
    growth_head = ("recordings", "ingest, two processes [s]", "caller [s]", "list [ms]", "load [s]", "peak of the caller [MB]")
    job = (
        f"On paper, {RAW_BYTES / 1e12:.0f} TB of raw files on {MACHINES} machines of {CORES} cores (row of the cluster): "
        "hours that each part takes alone."
    )
    faults = markdown(
        ("fault", "same version"), [(row["fault"], "yes" if row["same_result"] else "**no**") for row in result["faults"]], "ll"
    )
    parts = (
        words,
        markdown(head, rows),
        "Growth, an exponent of 1 is proportional:",
        markdown(growth_head, growth_rows, "r"),
        job,
        markdown(HEAD, estimate_rows(result)),
        f"`sysid gap` on {SEARCHED} of these recordings, after a first gap in the same processes:",
        markdown(GAP_HEAD, table_rows(result["gap"])),
        faults,
    )
    return "\n\n".join(parts)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--recordings", type=int, default=48)
    parser.add_argument("--growth", type=int, nargs="+", default=[12, 24, 48, 96], help="numbers of recordings, ascending")
    parser.add_argument("--publish", action="store_true", help="write the committed result and its page")
    options = parser.parse_args()
    # The workers import the measured tasks from this folder.
    paths = [str(ROOT / "pipelines"), str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    os.environ["PYTHONPATH"] = os.pathsep.join(paths)
    workers, growing = (" ".join(map(str, numbers)) for numbers in (options.workers, options.growth))
    words = f"--work WORK --workers {workers} --recordings {options.recordings} --growth {growing}"
    head = provenance(f"python pipelines/scale.py {words} --publish", None, ("distributed", "pyarrow", "deltalake"))
    result = {**head, **study(options.work, options.workers, options.recordings, options.growth)}
    write_result(options.work / "result.json", result)
    sys.stdout.write(f"{tables(result)}\n")
    if options.publish:
        write_result(RESULT, result)
        write_tables(PAGE, tables(result), "pipelines/scale.py")


if __name__ == "__main__":
    main()
