"""One deployment: the runner follows a path on the sealed machine over its bus; motion capture watches.

The flight log and the export of the motion capture are a recording for `sysid ingest`; the error of the tool comes from the true
motion of the bench.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from loop.bench_line import BenchLine
from sysid.bench.capture import capture
from sysid.bench.live import LiveProcess
from sysid.bench.machine import Truth
from sysid.bench.motive_export import wall_clock, write_motive
from sysid.bench.recipe import AXES, BenchRecipe, RecordingSettings
from sysid.registry import Registry
from sysid.runner.assemble import assemble
from sysid.runner.can import CanSettings, CanTransport
from sysid.runner.cycle import Cycle
from sysid.runner.flight_log import FlightLog, provenance
from sysid.runner.operator import Unattended
from sysid.runner.recipe import parse_runner

Array = npt.NDArray[np.float64]

DATABASE = Path(__file__).resolve().parents[2] / "rl" / "autolog" / "machine.dbc"
SIGNALS = {
    "slew.joint": "SLEW_SENSOR.slew",
    "boom.cylinder": "DRAW_WIRES.boom",
    "stick.cylinder": "DRAW_WIRES.stick",
    "telescope.joint": "DRAW_WIRES.telescope",
}
VALVES = {axis: f"AUX_VALVE_{k}_COMMAND" for k, axis in enumerate(AXES)}
#: Rest before a run, in which the motion capture sees the parked machine [s].
REST_S = 3.0


@dataclass(frozen=True)
class Deployment:
    """What controls the machine: versions of the registry.

    Args:
        policy: ``ik-lookahead``, ``ik`` or a policy.
        name: of the controller, for tables.
    """

    plant: str
    forward: str
    policy: str = "ik-lookahead"


@dataclass(frozen=True)
class Flight:
    """A run as the bench saw it.

    Args:
        time: of the targets, (n,) [s]. target, tip, tool: (n, 3) [m]; the tool is raised by its distance below the resting tip.
        ended, why: of the run.
        log: folder of the recording.
    """

    path: str
    time: Array
    target: Array
    tip: Array
    tool: Array
    ended: str
    why: str
    log: Path

    @property
    def error(self) -> Array:
        """Tool against target, (n, 3) [m]."""
        return self.tool - self.target

    def figures(self) -> dict[str, Any]:
        """Error at tool and tip [mm]."""
        tip = self.tip - self.target
        return {
            "rmse_mm": (1e3 * np.sqrt(np.mean(self.error**2, axis=0))).tolist(),
            "max_mm": (1e3 * np.abs(self.error).max(axis=0)).tolist(),
            "tip_max_mm": (1e3 * np.abs(tip).max(axis=0)).tolist(),
            "seconds": float(self.time[-1] - self.time[0]),
            "ended": self.ended,
        }


def fly(
    machine: BenchRecipe, site: Path, logs: Path, registry: Registry, deployment: Deployment, task: Mapping[str, Any], seed: int
) -> Flight:
    """Run ``task`` (``mode`` and its table of a runner recipe) on ``machine``; the recording goes below ``logs``.

    Args:
        seed: of the noise of this run.
    """
    versions = {"plant": deployment.plant, "forward": deployment.forward, "policy": deployment.policy}
    models = [name for name in versions.values() if "@" in name]
    values = {
        "schema": 1,
        "name": "loop",
        "machine": str(site / "machine.toml"),
        "versions": versions | {"unpromoted": _unpromoted(registry, models)},
        "transport": {"kind": "can"},
        "checks": {"without": {"domain": "the forward model is the plant's own kinematics, not a network"}},
        "loop": {"settle_s": REST_S, "priority": 0, "lock_memory": False},
        **task,
    }
    recipe = parse_runner(values, "deployment")
    assembly = assemble(recipe, registry, site / "runner.toml")
    line = BenchLine(LiveProcess(machine, DATABASE, seed))
    transport = CanTransport(CanSettings(DATABASE, SIGNALS, VALVES), bus=line, clock=line)
    words = provenance({"machine": assembly.machine_file}, {version.kind: version.reference for version in assembly.loaded.versions})
    began = time.time_ns() - line.now_ns()
    log = FlightLog(logs, assembly.machine_file, transport.axes, transport.signals, words, clock_ns=line.now_ns())
    cycles: list[Cycle] = []
    with log:
        outcome = assembly.loop(transport, log, Unattended(line)).run(cycles.append)
    truth = line.truth
    _export(machine, truth, began, seed, log.folder)
    return _flight(str(values.get("track", {}).get("path", recipe.mode)), machine, truth, cycles, outcome, log.folder)


def _unpromoted(registry: Registry, references: list[str]) -> list[str]:
    from sysid.registry import CHAMPION

    return [name for name in references if CHAMPION not in registry.find(name).aliases]


def _flight(path: str, machine: BenchRecipe, truth: Mapping[str, Array], cycles: list[Cycle], outcome: Any, log: Path) -> Flight:
    tracked = [cycle for cycle in cycles if cycle.state == "running" and np.isfinite(cycle.target).all()]
    period = 1e9 / machine.controller.rate
    at = np.array([cycle.at_ns + period for cycle in tracked])  # a target is that of the end of its cycle
    points = {
        name: np.column_stack([np.interp(at, truth["at_ns"], truth[f"{name}.{letter}"]) for letter in "xyz"])
        for name in ("ee", "tool")
    }
    raised = points["tool"] + [0.0, 0.0, machine.gripper.length]
    target = np.array([cycle.target for cycle in tracked]).reshape(-1, 3)
    return Flight(path, 1e-9 * at, target, points["ee"], raised, outcome.ended, outcome.why, log)


def _export(machine: BenchRecipe, truth: Mapping[str, Array], began: int, seed: int, folder: Path) -> None:
    """Write the take of the motion capture beside the flight log."""
    at = truth["at_ns"]
    n = len(at)

    def columns(names: list[str]) -> Array:
        return np.column_stack([truth[name] for name in names])

    motion = Truth(
        1e-9 * (at - at[0]),
        columns([f"{name}.passed" for name in AXES]),
        columns([f"{name}.drive" for name in AXES]),
        columns([f"{name}.joint" for name in AXES]),
        columns([f"ee.{letter}" for letter in "xyz"]),
        columns([f"tool.{letter}" for letter in "xyz"]),
        np.zeros((0, 2)),
        np.zeros((n, 9)),
        np.zeros((n, len(AXES))),
    )
    recording = RecordingSettings("flight", seed=seed, seconds=float(motion.time[-1]))
    take = capture(machine, recording, motion, np.random.default_rng([machine.seed, seed, 2]))
    started = wall_clock(round(began + at[0]), take.clock.offset)
    write_motive(take, folder / "mocap.csv", folder.name, started, machine.capture.capture_rate)
