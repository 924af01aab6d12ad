"""The runner on the simulated test bench, over slcan: `python pipelines/runner.py` after `make demo`.

Helix and circle are followed by inverse kinematics and, with `--policy`, by a policy, alone on the computer and with three busy
processes; then every fault is injected while the machine moves, and the machine is commissioned with every fault of its
wiring. The true motion is read from the bench's file. Writes `reports/runner/result.json` and the tables of
its README. `--keep-runs` measures the faults only and keeps the timed runs of the result, with the computer and date of their
measurement.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
import tty
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from committed import markdown, provenance, write_result, write_tables
from runner_flight import AXES, DRIFT, DRIVEN, KEEPS, LINE, LOOP, NO_FAULT, POLICY, SECOND_RUNNER, TURNS, first_moves, wiring
from simulated_bench.live import read_truth
from sysid.logs.mcap import McapReader
from sysid.logs.reader import ReadOptions
from sysid_rl.run.checks.settings import BOUNDS

Array = npt.NDArray[np.float64]
ROOT = Path(__file__).resolve().parents[1]
REPORT = ROOT / "reports" / "runner"
COMMAND = "python pipelines/runner.py"
DATABASE = ROOT / "rl/autolog/machine.dbc"
#: Recipe of the runner; the fence holds the path and the place where the machine is parked.
RECIPE = """schema = 1
name = "bench"
machine = "{root}/datasets/autolog/machine.toml"
mode = "{mode}"
[versions]
plant = "{plant}"
forward = "{forward}"
policy = "{policy}"
unpromoted = {unpromoted}
[track]
path = "{path}"
laps = {laps}
[limits.fence]
x = [0.45, 1.45]
y = [-0.5, 0.5]
z = [0.0, 0.85]
[loop]
seconds = {seconds}
[transport]
kind = "slcan"
channel = "{folder}/can0"
control = "{folder}/control"
database = "{database}"
[transport.signals]
"slew.joint" = "SLEW_SENSOR.slew"
"boom.cylinder" = "DRAW_WIRES.boom"
"stick.cylinder" = "DRAW_WIRES.stick"
"telescope.joint" = "DRAW_WIRES.telescope"
[transport.valves]
slew = "AUX_VALVE_0_COMMAND"
boom = "AUX_VALVE_1_COMMAND"
stick = "AUX_VALVE_2_COMMAND"
telescope = "AUX_VALVE_3_COMMAND"
{more}"""
FENCE = np.array([[0.45, 1.45], [-0.5, 0.5], [0.0, 0.85]])
#: Another program that reads a line.
READER = "import os, sys; f = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)\nwhile True: os.read(f, 64)"
#: Limits of a commissioning: duration [s], displacement of the boom tip [m], and its speed over a time [m/s, s].
COMMISSION_S, FAR, FAST, OVER_S = 150.0, 0.02, 0.05, 0.05
#: Evaluated time after a fault [s].
AFTER = 4.0


#: A first move: duration [s], way of the joint that moves [rad or m], and the reason of a waiver.
FIRST_MOVE_S = 14.0
STROKES = {"slew": 0.3, "boom": 0.25, "stick": 0.3, "telescope": 0.06}
WAIVED = "the simulated test bench of the fault tests"
#: For ``--only``: all first moves.
FIRST_MOVES = "first moves"


@dataclass
class RunRecord:
    """A run: lines on the runner's output, its outcome, the true motion of the machine, and the time of the fault."""

    lines: list[tuple[str, int, str]]
    outcome: dict[str, Any]
    truth: dict[str, Array]
    cycles: dict[str, Array]
    fault_ns: int = 0
    second_outcome: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class ExternalFault:
    """A fault that does not come from inside the runner.

    Args:
        machine: lines for the control pipe. kill: ``runner`` or ``machine``. pause: the runner stands still for so long [s].
        signals: that the runner gets, 50 ms apart. terminal: what becomes of it, see :class:`Terminal`.
        second: another runner is started on the same line. reader: another program reads it.
        database: of machine and runner, one of :data:`DATABASES`. lasts: time in which it is found at the latest [s].
        carried: sets of commands that are on the line when it is found; a machine without stamps executes them.
    """

    machine: tuple[str, ...] = ()
    kill: str = ""
    pause: float = 0.0
    signals: tuple[signal.Signals, ...] = ()
    terminal: str = ""
    second: bool = False
    reader: bool = False
    database: str = ""
    lasts: float = AFTER
    carried: int = 0


def _without(*signals: str) -> Callable[[str], str]:
    return lambda text: "".join(
        line for line in text.splitlines(keepends=True) if not any(f" {name} " in line for name in signals)
    )


#: Databases of machines that state less about their time: neither stamp nor echo; no time either; a clock of 14 bits.
DATABASES: dict[str, Callable[[str], str]] = {
    "no stamp and echo": _without("stamp", "echo"),
    "no stamp, echo and time": _without("stamp", "echo", "time"),
    "clock of 1.6 s": lambda text: _without("stamp")(text).replace(
        "32|32@1+ (0.0001,0) [0|429496.7295]", "32|14@1+ (0.0001,0) [0|1.6383]"
    ),
}
GROWS = {"lasts": 12.0}


def _dropped(count: int) -> ExternalFault:
    return ExternalFault(tuple(f"drop {name} {count}" for name in ("MACHINE_STATUS", "DRAW_WIRES", "SLEW_SENSOR")))


EXTERNAL_FAULTS = {
    "1 frame dropped": _dropped(1),
    "5 frames in a row dropped": _dropped(5),
    "20 frames in a row dropped": _dropped(20),
    "sensor unplugged": ExternalFault(("unplug DRAW_WIRES 1",)),
    "sensor repeats a frame": ExternalFault(("stuck DRAW_WIRES 1",)),
    "emergency stop": ExternalFault(("emergency_stop 1",)),
    "dead-man released": ExternalFault(("dead_man 0",)),
    "runner paused 300 ms": ExternalFault(pause=0.3),
    "runner paused 2 s, dead-man released": ExternalFault(("dead_man 0",), pause=2.0),
    "terminal stopped for 2 s (Ctrl-S)": ExternalFault(terminal="stop"),
    "terminal closed": ExternalFault(terminal="close"),
    "standard error closed": ExternalFault(terminal="close error"),
    "SIGINT (Ctrl-C)": ExternalFault(signals=(signal.SIGINT,)),
    "SIGTERM": ExternalFault(signals=(signal.SIGTERM,)),
    "SIGHUP": ExternalFault(signals=(signal.SIGHUP,)),
    "SIGTSTP (Ctrl-Z)": ExternalFault(signals=(signal.SIGTSTP,)),
    "SIGTERM twice": ExternalFault(signals=(signal.SIGTERM, signal.SIGTERM)),
    "a second runner on the line": ExternalFault(second=True),
    "kill -9 of the runner": ExternalFault(kill="runner"),
    "kill -9 of the machine": ExternalFault(kill="machine"),
    "another program reads the line": ExternalFault(reader=True),
    "adapter acknowledges, sends nothing": ExternalFault(("swallow 1",)),
    "adapter acknowledges what nobody sent": ExternalFault(("answers 20",)),
    "status frames swapped": ExternalFault(("overtake 1",)),
    "clock of the machine 20 ms back": ExternalFault(("clock -0.02",)),
    "clock of the machine 10 s back": ExternalFault(("clock -10",)),
    "clock of the machine begins anew": ExternalFault(("clock 0",), database="clock of 1.6 s"),
    "frames later by 20 ms/s": ExternalFault(("late_frames 0 20",), **GROWS),
    "frames later by 20 ms/s, swapped": ExternalFault(("overtake 1", "late_frames 0 20"), **GROWS),
    "frames later by 20 ms/s, swapped, no stamp and echo": ExternalFault(
        ("overtake 1", "late_frames 0 20"), database="no stamp and echo", **GROWS
    ),
    "frames later by 20 ms/s, swapped, no time either": ExternalFault(
        ("overtake 1", "late_frames 0 20"), database="no stamp, echo and time", **GROWS
    ),
    "frames 200 ms late, no stamp, echo and time": ExternalFault(("late_frames 200 0",), database="no stamp, echo and time"),
    "commands 200 ms late": ExternalFault(("late_commands 200 0",)),
    "commands 200 ms late, no stamp and echo": ExternalFault(
        ("late_commands 200 0",), database="no stamp and echo", carried=20
    ),
    "commands later by 20 ms/s": ExternalFault(("late_commands 0 20",), **GROWS),
    "commands later by 20 ms/s, no stamp and echo": ExternalFault(
        ("late_commands 0 20",), database="no stamp and echo", **GROWS
    ),
}
#: The state that a fault has to end in.
ENDS: dict[str, tuple[str, ...]] = {
    "1 frame dropped": ("goes on",),
    "5 frames in a row dropped": ("goes on", "stopped"),
    "sensor unplugged": ("stopped", "fault"),
    "emergency stop": ("fault",),
    "bus off": ("fault",),
    "kill -9 of the machine": ("fault",),
    "kill -9 of the runner": ("machine's own time-out",),
    **dict.fromkeys(POLICY, ("goes on",)),
    DRIFT: ("fault",),
    "terminal stopped for 2 s (Ctrl-S)": ("goes on",),
    "a second runner on the line": ("goes on",),
    LOOP: ("fault",),
    "line cannot be read": ("fault",),
    "SIGTERM twice": ("fault",),
    KEEPS: ("fault",),
    "adapter acknowledges, sends nothing": ("fault",),
    "adapter acknowledges what nobody sent": ("goes on",),
    "status frames swapped": ("goes on",),
    "clock of the machine 20 ms back": ("goes on",),
    "clock of the machine begins anew": ("goes on",),
}
#: What a verdict, or the outcome of the second runner, says.
SAID = {
    "a second runner on the line": "another runner has this line",
    "another program reads the line": "has the line open too",
}
#: Errors for which the runner refuses to start: text at the end of the recipe, or replaced in it or in the database.
REFUSED: dict[str, dict[str, str]] = {
    "wrong DBC": {"database_old": "BO_ 423 ", "database_new": "BO_ 424 "},
    "DBC with a signal more": {
        "database_old": " SG_ stamp",
        "database_new": ' SG_ more : 62|2@1+ (1,0) [0|3] "" MACHINE\n SG_ stamp',
    },
    "DBC with stamp, without time": {"database_old": "SG_ time", "database_new": "SG_ clock"},
    "threshold of 10⁶": {"more": "[checks.motion]\nseconds = 1e6\n"},
    "one message for two axes": {"recipe_old": "VALVE_3", "recipe_new": "VALVE_2"},
    "one sensor for two axes": {"recipe_old": "DRAW_WIRES.stick", "recipe_new": "DRAW_WIRES.boom"},
    "thresholds of 10⁹": {"more": "[checks]\n" + "".join(f"{key} = 1_000_000_000\n" for key in BOUNDS)},
}
#: Log faults are noticed at the next sync: tried at so many moments of its second, and the worst is kept.
PHASES = 3
#: State of a run that ended before its fault, and the most attempts to repeat it.
EARLY, ATTEMPTS = "ended before the fault", 3
STOPS = ("stopped", "fault")


@contextmanager
def machine(folder: Path, seconds: float, database: Path) -> Iterator[subprocess.Popen[str]]:
    words = [sys.executable, "-P", "-m", "simulated_bench", "live", str(ROOT / "datasets/autolog/bench.toml")]
    words += ["--database", str(database), "--pty", str(folder / "can0"), "--control", str(folder / "control")]
    words += ["--truth", str(folder / "truth.bin"), "--seconds", str(seconds)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=_environment()) as process:
        try:
            assert process.stdout is not None
            if not process.stdout.readline().startswith("ready"):
                raise RuntimeError("the simulated test bench did not start")
            yield process
        finally:
            process.kill()


class Terminal:
    """The runner's terminal, whose output is read; standard error may be a pipe instead."""

    def __init__(self, piped: bool) -> None:
        self.master, self.slave = os.openpty()
        self._read, self.error = os.pipe() if piped else (self.master, os.dup(self.slave))
        if not piped:
            tty.setcbreak(self.slave)
        self._reads = threading.Event()
        self._reads.set()
        threading.Thread(target=self._look, daemon=True).start()

    def begun(self) -> None:
        """The runner has its end now."""
        os.close(self.slave)
        os.close(self.error)

    def fail(self, what: str) -> None:
        """``stop``: Ctrl-S for 2 s without reading; ``close``, ``close error``: the terminal, or standard error, is closed."""
        if what == "stop":
            self._reads.clear()
            os.write(self.master, b"\x13")
            time.sleep(2.0)
            os.write(self.master, b"\x11")
            self._reads.set()
        elif what == "close error":
            os.close(self._read)
        else:
            os.close(self.master)

    def close(self) -> None:
        with suppress(OSError):
            os.close(self.master)

    def _look(self) -> None:
        with suppress(OSError):
            while self._reads.wait() and os.read(self._read, 65536):
                pass


@contextmanager
def busy(count: int) -> Iterator[None]:
    """So many processes that do nothing but compute."""
    with ExitStack() as stack:
        for _ in range(count):
            process = stack.enter_context(subprocess.Popen([sys.executable, "-c", "while True: pass"]))
            stack.callback(process.kill)
        yield


def _environment() -> dict[str, str]:
    """One thread each: this computer has few cores."""
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    return os.environ | {"PYTHONPATH": os.pathsep.join(str(ROOT / folder) for folder in (".", "rl", "pipelines"))} | threads


def run_once(
    options: argparse.Namespace, path: str, policy: str, seconds: float, fault: str = "", turns: int = TURNS, **change: str
) -> RunRecord:
    """One run, with a fault where one is named, ``turns`` cycles after tracking began."""
    outside = EXTERNAL_FAULTS.get(fault, ExternalFault())
    with tempfile.TemporaryDirectory(prefix="runner-") as name:
        folder = Path(name)
        database = DATABASE
        if outside.database:
            database = folder / "machine.dbc"
            database.write_text(DATABASES[outside.database](DATABASE.read_text("utf-8")), "utf-8")
        values = {
            "root": ROOT, "plant": options.plant, "forward": options.forward, "policy": policy, "path": path,
            "unpromoted": json.dumps(options.unpromoted), "laps": int(seconds / 5.0) + 5, "seconds": seconds,
            "folder": folder, "database": database, "mode": "track", "more": "", **change,
        }  # fmt: skip
        if "database_old" in change:
            wrong = DATABASE.read_text("utf-8").replace(change["database_old"], change["database_new"])
            (folder / "wrong.dbc").write_text(wrong, "utf-8")
            values["database"] = folder / "wrong.dbc"
        recipe = folder / "runner.toml"
        with machine(folder, seconds + 120.0, database) as bench, ExitStack() as stack:
            if values["mode"] in ("commission", "replay"):
                parked = _parked(folder / "truth.bin")
                values["more"] += f"[commission.reference]\n{_parked_joints(parked)}"
            if values["mode"] == "replay":
                _write_stroke(folder / "stroke.csv", parked, change["axis"])
            text = RECIPE.format(**values)
            recipe.write_text(text.replace(change.get("recipe_old", "\0"), change.get("recipe_new", "")), "utf-8")
            second = stack.enter_context(_second(recipe, options)) if outside.second else None
            words = _program(recipe, options, fault, str(turns))
            screen = Terminal(piped=outside.terminal == "close error")
            ends = {"stdin": screen.slave, "stderr": screen.error, "stdout": subprocess.PIPE}
            with subprocess.Popen(words, text=True, env=_environment(), **ends) as runner:
                screen.begun()
                lines, fault_ns = _listen(runner, bench, screen, folder, outside, second, stack)
            screen.close()
            if fault:
                time.sleep(0.5)
            truth = read_truth(folder / "truth.bin")
            return RunRecord(lines, _outcome(folder), truth, _cycles(folder), fault_ns, _outcome(folder / "second"))


def _program(recipe: Path, options: argparse.Namespace, *more: str) -> list[str]:
    return [sys.executable, str(ROOT / "pipelines/runner_flight.py"), str(recipe), str(options.workspace), *more]


def _parked(truth: Path) -> dict[str, float]:
    """Where the machine is parked."""
    until = time.monotonic() + 5.0
    while not len((rows := read_truth(truth))["at_ns"]) and time.monotonic() < until:
        time.sleep(0.01)
    return {name: float(values[0]) for name, values in rows.items()}


def _write_stroke(path: Path, parked: dict[str, float], moved: str) -> None:
    """A replay of joints in which one axis alone goes forth and back."""
    s = np.linspace(0.0, 1.0, 601)
    way = {axis: STROKES[axis] * np.sin(np.pi * s) ** 2 * (axis == moved) for axis in AXES}
    columns = [6.0 * s, *(parked[f"{axis}.joint"] + way[axis] for axis in AXES)]
    head = ",".join(["time", *(f"{axis}.joint" for axis in AXES)])
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=head, comments="")


def _parked_joints(row: dict[str, float]) -> str:
    """Where the machine is parked, as lines of a recipe."""
    return "".join(f'"{signal}" = {row[signal.replace(".cylinder", ".drive")]!r}\n' for signal in DRIVEN)


@contextmanager
def _second(recipe: Path, options: argparse.Namespace) -> Iterator[subprocess.Popen[str]]:
    """Another runner with the same recipe, in a folder of its own, that waits for a line before it opens its line."""
    second = recipe.parent / "second" / "runner.toml"
    second.parent.mkdir()
    second.write_text(recipe.read_text("utf-8"), "utf-8")
    words = _program(second, options, SECOND_RUNNER)
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env=_environment()) as process:
        try:
            yield process
        finally:
            process.kill()


def _outcome(folder: Path) -> dict[str, Any]:
    """How the run in ``folder`` ended."""
    outcome = folder / "outcome.json"
    return dict(json.loads(outcome.read_text("utf-8"))) if outcome.exists() else {}


def _listen(
    runner: subprocess.Popen[str],
    bench: subprocess.Popen[str],
    screen: Terminal,
    folder: Path,
    outside: ExternalFault,
    second: subprocess.Popen[str] | None,
    stack: ExitStack,
) -> tuple[list[tuple[str, int, str]], int]:
    """Lines of the runner until it ends, and the time of the fault."""
    assert runner.stdout is not None
    lines, fault_ns = [], 0
    for line in runner.stdout:
        word, ns, *rest = line.rstrip("\n").split(" ", 2)
        lines.append((word, int(ns), rest[0] if rest else ""))
        if word == "fault":
            fault_ns = int(ns)
        elif word == "track" and outside != ExternalFault():
            fault_ns = time.monotonic_ns()
            if outside.machine:
                with (folder / "control").open("w") as pipe:
                    pipe.write("".join(f"{item}\n" for item in outside.machine))
            if outside.pause:
                runner.send_signal(signal.SIGSTOP)
                time.sleep(outside.pause)
                runner.send_signal(signal.SIGCONT)
            if outside.kill:
                (runner if outside.kill == "runner" else bench).kill()
            for number in outside.signals:
                runner.send_signal(number)
                time.sleep(0.05)
            if outside.terminal:
                threading.Thread(target=screen.fail, args=(outside.terminal,)).start()
            if second is not None:
                second.communicate("open\n")
            if outside.reader:
                stack.callback(subprocess.Popen([sys.executable, "-c", READER, str(folder / "can0")]).kill)
    return lines, fault_ns


def _cycles(folder: Path) -> dict[str, Array]:
    """Numbers of the flight log's cycles; nothing where the run was refused."""
    for path in (folder / "logs").glob("*/flight.mcap"):
        if path.stat().st_size > 10_000:
            for stream in McapReader().read(path, ReadOptions()):
                if stream.name == "/cycles":
                    return {name: np.asarray(values, dtype=np.float64) for name, values in stream.columns.items()}
    return {}


def _tip_positions(truth: dict[str, Array]) -> Array:
    """Boom tips (n, 3) [m]."""
    return np.stack([truth[f"ee.{letter}"] for letter in "xyz"], axis=1)


def _opened(truth: dict[str, Array]) -> npt.NDArray[np.bool_]:
    """Whether the watchdog lets a command through to any valve, (n,)."""
    return np.stack([truth[f"{axis}.passed"] for axis in AXES], axis=1).any(axis=1)


def _begun(record: RunRecord) -> Array:
    """Begin of each cycle on the monotonic clock [ns]; the first line of the runner has that of the first cycle."""
    begun = record.cycles["due_ns"] + record.cycles["lateness_ns"]
    return np.asarray(begun - (begun[0] - record.lines[0][1]))


def _tracking_errors(record: RunRecord, first_ns: float, last_ns: float) -> Array:
    """Boom tip less its target in the cycles between, (n, 3) [m]; a target is for the end of its cycle."""
    targets = np.stack([record.cycles[f"target[{k}]"] for k in range(3)], axis=1)
    at = _begun(record) + 1e7
    own = (at >= first_ns) & (at <= last_ns) & np.isfinite(targets[:, 0])
    places = _tip_positions(record.truth)
    there = np.stack([np.interp(at[own], record.truth["at_ns"], column) for column in places.T], axis=1)
    return np.asarray(there - targets[own])


def timing(record: RunRecord) -> dict[str, Any]:
    """Lateness, missed deadlines, from the command to the valve, and how far the tip is from its target."""
    truth, cycles = record.truth, record.cycles
    if not cycles:
        raise RuntimeError(f"the run did not come about: {record.outcome.get('why')}")
    # The n-th set of commands has the counter n + 1; when it arrived is in the truth, as is when each cycle began.
    begun = _begun(record)
    fresh = np.flatnonzero(np.diff(truth["counter"]) != 0) + 1
    turns = (truth["counter"][fresh].astype(int) - 1) % 256
    arrived = truth["counter_ns"][fresh]
    near = np.searchsorted(begun, arrived) - 1
    numbers = near - (near - turns) % 256
    numbers = np.where(near - numbers > 128, numbers + 256, numbers)
    good = (numbers >= 0) & (numbers < len(begun))
    ways = (arrived[good] - begun[numbers[good]]) * 1e-3
    error = 1e3 * _tracking_errors(record, 0.0, np.inf)[200:]
    outcome = record.outcome
    return {
        "lateness_us": outcome["lateness_us"],
        "turn_us": outcome["turn_us"],
        "turns": outcome["turns"],
        "missed": outcome["missed"],
        "begin_to_valve_us": {
            "p50": float(np.percentile(ways, 50)), "p99": float(np.percentile(ways, 99)), "max": float(ways.max())
        },
        # None: it ended before it had come to the path.
        "rmse_mm": np.sqrt((error**2).mean(axis=0)).tolist() if len(error) else None,
        "max_mm": np.abs(error).max(axis=0).tolist() if len(error) else None,
        "ended": outcome["ended"],
        "why": outcome["why"],
        "notes": outcome["notes"],
    }  # fmt: skip


def evaluated(name: str, record: RunRecord) -> dict[str, Any]:
    """What became of the machine after a fault."""
    truth, t0 = record.truth, record.fault_ns
    at, places = truth["at_ns"], _tip_positions(truth)
    inside = bool(((places >= FENCE[:, 0]) & (places <= FENCE[:, 1])).all())
    if record.outcome.get("ended") == "refused":
        # Before anything was sent.
        moved = float(np.linalg.norm(places - places[0], axis=1).max())
        row = {"reaction_ms": 0.0, "peak_motion_m": moved, "state": "refused", "noticed": record.outcome["why"]}
        return {"fault": name, **row, "ok": moved < 1e-6 and name in REFUSED}
    if not t0:
        return {
            "fault": name, "reaction_ms": 0.0, "peak_motion_m": 0.0, "state": EARLY, "noticed": "",
            "why": record.outcome.get("why", ""), "ok": False,
        }  # fmt: skip
    outside = EXTERNAL_FAULTS.get(name, ExternalFault())
    after = (at >= t0) & (at <= t0 + outside.lasts * 1e9)
    opened = _opened(truth)
    moving = np.flatnonzero(after & opened)
    neutral = float((at[moving[-1]] - t0) * 1e-6) if len(moving) and moving[-1] + 30 < len(at) else 0.0
    again = _reopened(opened[at >= t0])
    # A clamp is everyday: setpoints of a policy that sees noise are held within their acceleration in every other cycle.
    verdicts = [
        (ns, text) for word, ns, text in record.lines if word == "verdict" and ns >= t0 and text.split(" ")[1] != "clamp"
    ]
    states = [(ns, text) for word, ns, text in record.lines if word == "state" and ns >= t0]
    noticed = min([ns for ns, _ in [*verdicts, *states]], default=0)
    killed = outside.kill
    reaction: float | None
    if killed == "runner":
        state, reaction = "machine's own time-out", neutral
    else:
        goes_on = record.outcome.get("ended") in ("time", "done")
        # Verdicts long after a fault that is over are about something else.
        reaction = (noticed - t0) * 1e-6 if noticed and not (goes_on and noticed - t0 > 1e9) else None
        state = "goes on" if goes_on else "fault" if record.outcome.get("state") == "fault" else "stopped"
    start = places[np.searchsorted(at, t0) - 1] if len(at) else places[0]
    peak = float(np.linalg.norm(places[after] - start, axis=1).max()) if after.any() else 0.0
    if (state == "goes on" or outside.lasts > AFTER) and record.cycles:
        # It goes on, for a time: the tracking error counts.
        last = t0 + 1e9 * (1.0 if state == "goes on" else outside.lasts)
        peak = float(np.linalg.norm(_tracking_errors(record, t0, last), axis=1).max())
    ok = state in ENDS.get(name, STOPS) and inside
    if name in SAID:
        ok = ok and SAID[name] in " ".join([record.second_outcome.get("why", ""), *(text for _, text in verdicts)])
    if state != "goes on" and killed != "machine":
        ok = ok and again <= outside.carried
        still = places[at >= at[-1] - 2e8]
        ok = ok and bool(np.ptp(still, axis=0).max() < 1e-3)
    return {
        "fault": name,
        "reaction_ms": reaction,
        "neutral_ms": None if state == "goes on" or killed == "machine" else neutral,
        "reopened": None if state == "goes on" or killed == "machine" else again,
        "peak_motion_m": peak,
        "state": state,
        "noticed": verdicts[0][1] if verdicts else "",
        "why": record.outcome.get("why", ""),
        "inside_fence": inside,
        "ok": ok,
    }


def commissioned(options: argparse.Namespace, name: str) -> dict[str, Any]:
    """What a commissioning makes of a fault that is there from the beginning."""
    return commissioning_row(name, run_once(options, options.paths[0], "ik-lookahead", COMMISSION_S, name, mode="commission"))


def first_moved(options: argparse.Namespace, name: str, waived: bool) -> dict[str, Any]:
    """What a first move makes of a fault that came after the commissioning, or of one that was waived."""
    axis = AXES[0] if name == NO_FAULT else first_moves(dict.fromkeys(DRIVEN, 0.0))[name].axis
    more = '[replay]\nfile = "stroke.csv"\n' + (f'[commission]\nwaived = "{WAIVED}"\n' if waived else "")
    record = run_once(options, options.paths[0], "ik-lookahead", FIRST_MOVE_S, name, mode="replay", more=more, axis=axis)
    record.fault_ns = record.lines[0][1] if record.lines else 0
    row = commissioning_row(name, record)
    if name == NO_FAULT:
        row["ok"] = not row["found"]
    return {**row, "waived": waived, "commissioned": record.outcome.get("commissioned", "")}


def commissioning_row(name: str, record: RunRecord) -> dict[str, Any]:
    """What came of a commissioning: found or not, after how long, and how the boom tip moved until then."""
    at, places = record.truth["at_ns"], _tip_positions(record.truth)
    lag = max(1, round(OVER_S * 1e9 / float(np.median(np.diff(at)))))
    far = float(np.linalg.norm(places - places[0], axis=1).max())
    fast = float(np.linalg.norm(places[lag:] - places[:-lag], axis=1).max()) / OVER_S
    passed = record.outcome.get("ended") == "done"
    why = record.outcome.get("why", "it did not begin")
    began = bool(record.fault_ns) and record.outcome.get("ended", "refused") != "refused"
    opened = _opened(record.truth)
    last = float(at[np.flatnonzero(opened)[-1]] - record.fault_ns) * 1e-9 if opened.any() else 0.0
    ok = began and passed == (name == NO_FAULT) and far <= FAR and fast <= FAST
    row = {"fault": name, "found": not passed, "moved_for_s": last, "tip_m": far, "tip_speed": fast}
    return {**row, "why": why, "ok": ok}


def _reopened(opened: npt.NDArray[np.bool_]) -> int:
    """Cycles of the machine with an open valve after all were neutral for three cycles in a row."""
    if len(opened) < 3:  # the machine is gone
        return 0
    shut = np.flatnonzero(np.convolve(~opened, np.ones(3), "valid") == 3)
    return int(opened[shut[0] :].sum()) if len(shut) else 0


def measured(options: argparse.Namespace, name: str, policy: str) -> dict[str, Any]:
    """What a fault makes of a run; of log faults the worst of several moments."""
    rows = []
    for phase in range(PHASES if name == "disk full" else 1):
        turns = TURNS + phase * 100 // PHASES
        for _ in range(ATTEMPTS):  # what other work on this computer ends before the fault comes has tried nothing
            seconds = 16.0 + EXTERNAL_FAULTS.get(name, ExternalFault()).lasts
            row = evaluated(name, run_once(options, options.paths[0], policy, seconds, name, turns, **REFUSED.get(name, {})))
            if row["state"] != EARLY:
                break
        rows.append(row)
    worst = max(rows, key=lambda row: (not row["ok"], row.get("neutral_ms") or 0.0))
    return worst if len(rows) == 1 else {**worst, "all_neutral_ms": [row.get("neutral_ms") for row in rows]}


def timed(options: argparse.Namespace, policies: Sequence[str]) -> dict[str, Any]:
    """The timed runs, and their summary."""
    runs = []
    for path in options.paths:
        for policy in policies:
            for load in (0, 3) if policy == policies[0] and path == options.paths[0] else (0,):
                with busy(load):
                    record = run_once(options, path, policy, 60.0 * options.minutes)
                row = {"path": path, "policy": policy, "busy": load, **timing(record)}
                runs.append(row)
                print(path, policy, load, row["lateness_us"], row["missed"], row["rmse_mm"], flush=True)
    idle = next(row for row in runs if row["busy"] == 0)
    loaded = next(row for row in runs if row["busy"] == 3)
    both = {"idle": idle, "loaded": loaded}
    return {
        "minutes": options.minutes,
        "runs": runs,
        **{key: {name: row[key] for name, row in both.items()} for key in ("lateness_us", "missed", "begin_to_valve_us")},
    }


#: Of a result: what :func:`timed` gives, and where and when that was measured.
TIMED = ("minutes", "runs", "lateness_us", "missed", "begin_to_valve_us", "runs_measured")


def main(options: argparse.Namespace) -> None:
    result: dict[str, Any] = provenance(COMMAND, 0, ("python-can", "cantools", "mcap"))
    result["plant"], result["forward"] = options.plant, options.forward
    policies = ["ik-lookahead", *options.policy]
    before = json.loads(options.out.read_text("utf-8")) if options.keep_runs or options.only else {}
    if options.keep_runs:
        kept = {key: before[key] for key in TIMED if key in before}
        result |= {"runs_measured": {key: before[key] for key in ("date", "machine", "versions")}} | kept
    else:
        result |= timed(options, policies)
    names = [*EXTERNAL_FAULTS, *LINE, LOOP, *POLICY, "disk full", *REFUSED] if options.faults else []
    rows = {row["fault"]: row for row in before["faults"]} if options.only else {}
    result["faults"] = list(rows.values())
    for name in [name for name in names if not options.only or name in options.only]:
        rows[name] = measured(options, name, policies[-1])
        print(json.dumps(rows[name]), flush=True)
        result["faults"] = [rows[name] for name in names if name in rows]
        write_result(options.out, result)
    known = {row["fault"]: row for row in before.get("commissioning", [])} if options.only else {}
    for name in wiring(dict.fromkeys(DRIVEN, 0.0)) if options.faults else ():
        if not options.only or name in options.only:
            known[name] = commissioned(options, name)
            print(json.dumps(known[name]), flush=True)
        result["commissioning"] = list(known.values())
        write_result(options.out, result)
    moved = {(row["fault"], row["waived"]): row for row in before.get("first_moves", [])} if options.only else {}
    for name in (NO_FAULT, *first_moves(dict.fromkeys(DRIVEN, 0.0))) if options.faults else ():
        # Each kind of fault is waived once, on the first axis.
        for waived in (False, True) if name == NO_FAULT or AXES[0] in name else (False,):
            if not options.only or name in options.only or FIRST_MOVES in options.only:
                moved[name, waived] = first_moved(options, name, waived)
                print(json.dumps(moved[name, waived]), flush=True)
        result["first_moves"] = list(moved.values())
        write_result(options.out, result)
    write_result(options.out, result)
    if options.out == REPORT / "result.json":
        pipeline = COMMAND.partition(" ")[2]
        tables = {"runs": runs_table, "faults": faults_table, "commissioning": commissioning_table}
        for name, table in tables.items():
            write_tables(REPORT / "README.md", table(result), f"{pipeline}: {name}")
    every = (*result["faults"], *result.get("commissioning", ()), *result.get("first_moves", ()))
    wrong = [row["fault"] for row in every if not row["ok"]]
    print(f"{options.out}; not as they should be: {', '.join(wrong) or 'none'}")


def runs_table(result: dict[str, Any]) -> str:
    def three(values: dict[str, float]) -> str:
        return " / ".join(f"{values[key]:.0f}" for key in ("p50", "p99", "max"))

    runs = [
        [f"{row['path']}, {row['policy']}", str(row["busy"]), str(row["turns"]), three(row["lateness_us"]), str(row["missed"]),
         three(row["begin_to_valve_us"]), " / ".join(f"{value:.1f}" for value in row["rmse_mm"] or ()) or "–",
         "" if row["ended"] == "time" else row["why"]]
        for row in result["runs"]
    ]  # fmt: skip
    head = ["run", "busy processes", "cycles", "lateness p50 / p99 / max, µs", "deadlines missed",
            "cycle begins → command at the valve, µs", "true tracking error, RMSE x / y / z, mm", "ended early"]  # fmt: skip
    return markdown(head, runs)


def faults_table(result: dict[str, Any]) -> str:
    def milliseconds(value: float | None) -> str:
        return "–" if value is None else f"{value:.0f} ms"

    faults = [
        [row["fault"], milliseconds(row["reaction_ms"]), milliseconds(row.get("neutral_ms")),
         "–" if row.get("reopened") is None else str(row["reopened"]), f"{1e3 * row['peak_motion_m']:.1f} mm", row["state"],
         "yes" if row["ok"] else "**no**"]
        for row in result["faults"]
    ]  # fmt: skip
    head = ["fault", "noticed after", "valves neutral after", "open again, cycles", "peak motion", "ends as", "as it should"]
    return markdown(head, faults)


def commissioning_table(result: dict[str, Any]) -> str:
    """Commissionings; then first moves, with a record of the wiring before, or with a waiver."""
    moves = [{**row, "fault": row["fault"] + (", waived" if row["waived"] else "")} for row in result.get("first_moves", ())]
    tables = [_wiring_table(result.get("commissioning", ()), "wiring")]
    return "\n\n".join([*tables, *([_wiring_table(moves, "wiring at the first move of a run")] if moves else [])])


def _wiring_table(measured: Sequence[dict[str, Any]], what: str) -> str:
    rows = [
        [row["fault"], "yes" if row["found"] else "no", f"{row['moved_for_s']:.1f} s", f"{1e3 * row['tip_m']:.1f} mm",
         f"{row['tip_speed']:.3f} m/s", "yes" if row["ok"] else "**no**"]
        for row in measured
    ]  # fmt: skip
    head = [what, "refused", "valves neutral after", "farthest from the beginning", "fastest", "as it should"]
    return markdown(head, rows)


def _options(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workspace", type=Path, default=Path("workspace"))
    parser.add_argument("--plant", default="autolog@2")
    parser.add_argument("--forward", default="autolog-forward")
    parser.add_argument("--policy", action="append", default=[], help="a policy version to follow the paths with as well")
    parser.add_argument("--unpromoted", action="append", default=[], help="a version to run though it was not promoted")
    parser.add_argument("--paths", nargs="+", default=["helix", "circle"])
    parser.add_argument("--minutes", type=float, default=10.0, help="of each run that is timed")
    parser.add_argument("--no-faults", dest="faults", action="store_false")
    parser.add_argument("--keep-runs", action="store_true", help="measure the faults alone; the runs stay as in --out")
    parser.add_argument("--only", nargs="+", default=[], help="of all faults these alone; the others stay as in --out")
    parser.add_argument("--out", type=Path, default=REPORT / "result.json")
    chosen = parser.parse_args(arguments)
    chosen.workspace = chosen.workspace.resolve()
    return chosen


if __name__ == "__main__":
    main(_options())
