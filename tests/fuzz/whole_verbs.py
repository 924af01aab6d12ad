"""What is fuzzed through whole verbs: machines at the edges of numbers, names in exports, watched folders, stored results."""

from __future__ import annotations

import ast
import contextlib
import functools
import io
import json
import os
import shutil
import sys
import tempfile
import tomllib
import warnings
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

#: Files that libraries look for in the current folder; the target plants the input in all of them.
PLANTED = (
    ".numba_config.yaml", "matplotlibrc", ".env", "dask.yaml", "distributed.yaml", "alembic.ini", "env.py", "MLproject",
    "mlruns/meta.yaml", "sitecustomize.py", "usercustomize.py", "conftest.py", "setup.cfg", "pyproject.toml", "can.conf",
    "can.ini", ".canrc", ".netrc", "pyvenv.cfg", ".git/config", "MUJOCO_LOG.TXT", "rerun.toml", "logging.conf", "click.py",
    "numpy.py", "sysid.py",
)  # fmt: skip


@contextlib.contextmanager
def _folder() -> Iterator[Path]:
    place = Path(tempfile.mkdtemp(dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    try:
        yield place
    finally:
        shutil.rmtree(place, ignore_errors=True)


def _verb(*argv: object) -> int:
    """Exit status of a verb in this process; anything but an error of ``sysid.errors`` leaves it."""
    from sysid.cli.app import run_command

    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return run_command([str(part) for part in argv])
        except SystemExit as end:  # the answer lacks a part
            return int(end.code or 0)


# -- machines -------------------------------------------------------------------------------------------------------


def run_edges(case: Any, place: Path, target: str = "json", view: bool = True) -> None:
    """Every verb that reads a dataset, on a machine of :mod:`edge_machines`."""
    from edge_machines import write_machine

    from sysid.errors import SysidError
    from sysid.export.export import export_plant, target_named
    from sysid.plant import nominal_plant
    from sysid.workspace import open_workspace

    folder, workspace = write_machine(case, place / "edge"), ("--workspace", place / "ws")
    out = place / "found.json"
    if _verb(*workspace, "ingest", folder, "--json", out):
        return
    for verb in ("datasets edge", "datasets edge --quality", "gap edge --localise", "report edge"):
        _verb(*workspace, *verb.split(), "--json", out)
        assert not json.loads(out.read_text("utf-8")).get("missing"), "a part of the answer failed"
    _verb(*workspace, "gap", "edge", "--localise", "--accept", "*", "--json", out)
    assert not json.loads(out.read_text("utf-8")).get("missing"), "a part of the answer failed"
    if view:
        _verb(*workspace, "view", "edge", "--out", place / "edge.rrd", "--json", out)
    dataset = open_workspace(place / "ws").dataset("edge")
    try:
        export_plant(nominal_plant(dataset.machine), dataset, target_named(target), place / "export", samples=2)
    except SysidError:
        return


def edges(data: bytes) -> None:
    """Each byte chooses a number of the machine or of its logs; the last the target of the export."""
    from edge_machines import from_bytes

    targets = ("json", "lut", "simulink", "sdf", "mjcf", "urdf", "fmu")
    with _folder() as place:
        viewed = zlib.crc32(data) % 16 == 0  # four threads of Rerun stay after each
        run_edges(from_bytes(data[:-1]), place, targets[(data[-1] if data else 0) % len(targets)], viewed)


def edge_seeds() -> tuple[bytes, ...]:
    ordinary = bytes(60)
    changed = ((0, 4), (0, 1), (1, 1), (1, 5), (3, 1), (4, 1), (4, 3), (5, 1), (6, 1), (6, 3), (7, 2), (7, 7), (8, 1), (9, 3))
    one = [ordinary[:at] + bytes([value]) + ordinary[at + 1 :] for at, value in changed]
    return (ordinary, *one)


# -- names ----------------------------------------------------------------------------------------------------------

#: Machine, three links, two joints, a note, a reference, a key and a value of the lineage; two axes.
PLACES = 12


def exported_names(data: bytes) -> None:
    """Texts separated by NUL as the names of a plant; each file that is written is read by the parser of its language."""
    from sysid.errors import SysidError
    from sysid.export.export import TARGETS
    from sysid.machine import machine_from_files
    from sysid.plant import nominal_plant
    from sysid.quoting import toml_value

    texts = [part.decode("utf-8", "replace") for part in data.split(b"\0")] + [f"t{k}" for k in range(PLACES)]
    name, base, upper, tip, first, second, note, reference, key, value, *axes = texts[:PLACES]
    machine = [f"schema = 1\nname = {toml_value(name)}\nrate_hz = 100.0\nurdf = 'm.urdf'\ntip = {toml_value(tip)}"]
    machine += [f"left_out = [{toml_value(note)}]"]
    for axis, joint in zip(axes, (first, second), strict=True):
        machine += ["[[axes]]", f"name = {toml_value(axis)}", f"joint = {toml_value(joint)}"]
        machine += ['actuation = "velocity"', 'drives = "joint"', "gain = 0.5"]
    files = {"machine.toml": "\n".join(machine), "m.urdf": _urdf((base, upper, tip), (first, second))}
    try:
        plant = nominal_plant(machine_from_files(files, "input"))
    except SysidError:
        return
    plant = replace(plant, reference=reference, origin={key: value})
    target = TARGETS[len(data) % len(TARGETS)]
    with _folder() as folder:
        _check_export(plant, target, folder)


def _check_export(plant: Any, target: Any, folder: Path) -> None:
    import xml.dom.minidom

    from sysid.errors import SysidError
    from sysid.export.page import export_page

    try:
        files = target.write(plant, 100.0, folder)
    except SysidError:
        return
    (folder / "README.md").write_text(export_page(plant, target, 100.0, files, None, {}), "utf-8")
    for path in folder.iterdir():
        if path.suffix == ".py":
            ast.parse(path.read_text("utf-8"))
        elif path.suffix == ".json":
            json.loads(path.read_text("utf-8"))
        elif path.suffix == ".toml":
            tomllib.loads(path.read_text("utf-8"))
        elif path.suffix in (".xml", ".sdf", ".urdf"):
            xml.dom.minidom.parse(str(path))
    if target.name == "mjcf":
        import mujoco

        mujoco.MjModel.from_xml_path(str(folder / "robot.xml"))
    names = target.names(plant)
    for group in (names.links, names.joints, names.axes):
        assert len(set(group.values())) == len(group), "two parts have one name"


def _urdf(links: Sequence[str], joints: Sequence[str]) -> str:
    from xml.sax.saxutils import quoteattr

    parts = [f"<link name={quoteattr(name)}/>" for name in links]
    for k, name in enumerate(joints):
        ends = f"<parent link={quoteattr(links[k])}/><child link={quoteattr(links[k + 1])}/>"
        more = '<axis xyz="0 1 0"/><origin xyz="0.3 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/>'
        parts.append(f'<joint name={quoteattr(name)} type="revolute">{ends}{more}</joint>')
    return f'<robot name="r">{"".join(parts)}</robot>'


def name_seeds() -> tuple[bytes, ...]:
    ordinary = [f"t{k}" for k in range(PLACES)]
    hostile = (
        '""" \' {x} %s',
        "world",
        "a::b",
        "*/ --> ]]>",
        "end",
        "class",
        "a\u202eb",
        "🙂",
        "x" * 190,
        "`|<b>",
        "a-b",
        "a_b",
    )
    rows = [ordinary, list(hostile), *([*ordinary[:k], text, *ordinary[k + 1 :]] for k, text in enumerate(hostile))]
    return tuple("\0".join(row).encode() + b"\0" * extra for row in rows for extra in range(1, 4))


# -- watched folders ------------------------------------------------------------------------------------------------


@functools.cache
def _watched() -> tuple[Path, bytes]:
    """A workspace whose dataset is watched, and the state of the watch."""
    from one_axis_logs import MACHINE, record

    from sysid.fleet.estimates import plant_sha256
    from sysid.workspace import open_workspace

    place = Path(tempfile.mkdtemp(dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    home = place / "logs"
    for seed in range(2):
        record(home / f"r{seed}", seed)
    (place / "machine.toml").write_text(MACHINE)
    (place / "recipe.toml").write_text(
        'schema = 1\nmachine = "machine.toml"\nlogs = "logs"\n[[streams]]\nfiles = "*.csv"\ntime = "time"\n[streams.signals]\n'
        '"a.command" = { field = "a.command" }\n"a.cylinder" = { field = "a.cylinder" }\n'
    )
    status = _verb("--workspace", place / "ws", "ingest", place)
    assert not status, "the workspace of the watch is made"
    workspace = open_workspace(place / "ws")
    dataset = workspace.dataset("demo")
    state = {
        "schema": 2,
        "machine": {"dataset": dataset.reference, "verdict": "no_gap", "effects": []},
        "plant": plant_sha256(workspace.plant(dataset, None)),
        "recordings": [],
        "histories": [],
        "reported": [],
    }
    return place, json.dumps(state).encode()


@contextlib.contextmanager
def _watch(state: bytes) -> Iterator[Path]:
    """A copy of the workspace in a folder ``w``, with this state."""
    with _folder() as place:
        shutil.copytree(_watched()[0], place / "w")
        (place / "w/ws/fleet/watch").mkdir(parents=True, exist_ok=True)
        (place / "w/ws/fleet/watch/demo.json").write_bytes(state)
        yield place / "w"


def watch_state(data: bytes) -> None:
    """The file of a watch: it is continued, or refused."""
    from sysid.errors import SysidError
    from sysid.fleet.watching import watch

    with _watch(data) as place:
        try:
            found = watch(place / "ws", "demo")
        except SysidError:
            return
        json.dumps(found.to_json(), allow_nan=False)
        watch(place / "ws", "demo")


def watch_seeds() -> tuple[bytes, ...]:
    state = json.loads(_watched()[1])
    with _watch(_watched()[1]) as place:
        from sysid.fleet.watching import watch

        watch(place / "ws", "demo")
        written = (place / "ws/fleet/watch/demo.json").read_bytes()
    effect = {"name": "valve_deadband", "target": "a", "side": None, "parameters": ["positive", "negative"]}
    history = {
        "machine": "demo", "effect": effect, "parameter": "positive", "unit": "1", "negligible": 0.01,
        "recordings": ["r0", "r1"], "ends": [0.1, 0.2], "values": [0.05, 0.06], "deviations": [0.01, 0.01],
    }  # fmt: skip
    newer = json.loads(written)
    more = [{**known, "histories": [history], "machine": {**state["machine"], "effects": [effect]}} for known in (state, newer)]
    return (_watched()[1], written, *(json.dumps(each).encode() for each in more))


#: What an entry of a folder that arrives is: a file, or something else in its place.
KINDS = ("file", "file", "folder", "link", "outside", "pipe")


def arrivals(data: bytes) -> None:
    """Entries of a log folder, ``kind name NUL content`` parted by FF FF: taken in, left out with a reason, or waited for."""
    from sysid.errors import SysidError
    from sysid.fleet.watching import watch

    with _watch(_watched()[1]) as place:
        folder = place / "arrived"
        (place.parent / "secret.csv").write_text("time,a.command,a.cylinder\n")
        for number, entry in enumerate(data.split(b"\xff\xff")[:8]):
            _put(folder / f"n{number % 3}", entry, place.parent / "secret.csv")
        before = sorted(path.name for path in place.parent.iterdir())
        try:
            found = watch(place / "ws", "demo", [folder], quiet_s=0.0)
            json.dumps(found.to_json(), allow_nan=False)
        except SysidError:
            pass
        assert sorted(path.name for path in place.parent.iterdir()) == before, "something was written outside"


def _put(folder: Path, entry: bytes, outside: Path) -> None:
    name, _, content = entry[1:].partition(b"\0")
    kind, name = KINDS[entry[0] % len(KINDS)] if entry else "file", name.replace(b"/", b"_")[:200]
    path = folder / os.fsdecode(name or b"log.csv")
    folder.mkdir(parents=True, exist_ok=True)
    if name in (b".", b"..") or path.is_symlink() or path.exists():
        return
    if kind == "file":
        path.write_bytes(content)
    elif kind == "folder":
        (path / "in").mkdir(parents=True)
        (path / "in/log.csv").write_bytes(content)
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to(outside if kind == "outside" else path)


def arrival_seeds() -> tuple[bytes, ...]:
    log = (_watched()[0] / "logs/r0/log.csv").read_bytes()[:3000].rpartition(b"\n")[0] + b"\n"
    entries = [bytes([kind]) + b"log.csv\0" + log for kind in range(len(KINDS))]
    return (entries[0], b"\xff\xff".join([entries[0], b"\0other.csv\0", entries[3]]), *entries[2:])


# -- results --------------------------------------------------------------------------------------------------------


@functools.cache
def _results() -> tuple[Path, bytes]:
    from sample_workspace import sample_workspace

    place = Path(tempfile.mkdtemp(dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    workspace = sample_workspace(place / "ws")
    return place, (workspace.gap_folder(workspace.dataset("autolog@1")) / "result.json").read_bytes()


def gap_result(data: bytes) -> None:
    """The stored result of a gap: three bytes an edit, which replace a value of the shipped one; the report is made of it."""
    import hashlib

    from sysid.errors import SysidError
    from sysid.reports.report import build_report
    from sysid.workspace import open_workspace

    place, stored = _results()
    folder = place / "ws/results/autolog@1/gap"
    content = data if data[:1] == b"{" else _edited(json.loads(stored), data)
    (folder / "result.json").write_bytes(content)
    seal = json.loads((folder / "seal.json").read_text())
    seal["sha256"]["result.json"] = hashlib.sha256(content).hexdigest()
    (folder / "seal.json").write_text(json.dumps(seal))
    workspace = open_workspace(place / "ws")
    try:
        page = build_report(workspace.report_inputs(workspace.dataset("autolog@1")), library="x")
    except SysidError:
        return
    assert "<img src=x" not in page, "a text became an element"


#: What a value of a result is replaced by.
VALUES: tuple[Any, ...] = ('"><img src=x onerror=a>', None, -1, 0.0, 1e308, [], {}, True, "", ["a"], {"a": 1})


def _edited(result: Any, data: bytes) -> bytes:
    for place, further, value in zip(data[0::3], data[1::3], data[2::3], strict=False):
        leaves = list(_leaves(result))
        holder, key = leaves[(256 * place + further) % len(leaves)]
        holder[key] = VALUES[value % len(VALUES)]
    return json.dumps(result).encode()


def _leaves(value: Any) -> Iterator[tuple[Any, Any]]:
    for key, item in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        yield value, key
        yield from _leaves(item)


def result_seeds() -> tuple[bytes, ...]:
    return (_results()[1][:16_000], b"", *(bytes([k, 7 * k % 256, k % len(VALUES)]) for k in range(6)))


# -- the current folder ---------------------------------------------------------------------------------------------


class _Opened:
    """Files that this process opens below a folder while it watches."""

    def __init__(self) -> None:
        self.below, self.found = "", list[str]()
        sys.addaudithook(self._hear)

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.below and event == "open" and isinstance(arguments[0], str | bytes):
            path = os.path.relpath(os.path.abspath(os.fsdecode(arguments[0])), self.below)
            self.found += [path] if path in PLANTED else []


@functools.cache
def _opened() -> _Opened:
    return _Opened()


def current_folder(data: bytes) -> None:
    """The input in every file that a library may look for in the current folder, while verbs run there: none is opened."""
    from edge_machines import from_bytes, write_machine

    home = Path.cwd()
    with _folder() as place:
        folder = write_machine(from_bytes(data[:40]), place / "edge")
        for name in PLANTED:
            (place / "here" / name).parent.mkdir(parents=True, exist_ok=True)
            (place / "here" / name).write_bytes(data)
        workspace, opened = ("--workspace", place / "ws"), _opened()
        os.chdir(place / "here")
        opened.found, opened.below = [], str(place / "here")
        try:
            _verb(*workspace, "ingest", folder)
            _verb(*workspace, "datasets", "edge", "--quality")
            _verb(*workspace, "gap", "edge", "--localise")
        finally:
            opened.below = ""
            os.chdir(home)
        assert not opened.found, f"opened in the current folder: {opened.found}"


def current_seeds() -> tuple[bytes, ...]:
    return (b"cache_dir: /tmp/x\nopt: 0\n", b"backend: module://planted\n", b"[a]\nb = c\n", b"import os\n", b"")


def forget() -> None:
    """Remove the folders of this process."""
    for made in (_watched, _results):
        if made.cache_info().currsize:
            shutil.rmtree(made()[0], ignore_errors=True)
            made.cache_clear()
