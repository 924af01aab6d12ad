"""Runs of the runner: on the sealed machine over its bus, and on a plant, each with the true motion of the tool."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from loop.bench_line import BenchLine
from loop.capture_export import export_take
from loop.deployment import Deployment
from simulated_bench.live import LiveProcess
from simulated_bench.recipe import AXES, BenchRecipe
from sysid.plant import Plant
from sysid.registry import Registry
from sysid_rl.run.can import CanSettings, CanTransport
from sysid_rl.run.clock import SECOND
from sysid_rl.run.cycle import Cycle
from sysid_rl.run.flight_log import FlightLog, provenance
from sysid_rl.run.operator import Unattended
from sysid_rl.run.outcome import RunOutcome
from sysid_rl.run.simulated import SimulatedTransport

Array = npt.NDArray[np.float64]

DATABASE = Path(__file__).resolve().parents[2] / "rl" / "autolog" / "machine.dbc"
SIGNALS = {
    "slew.joint": "SLEW_SENSOR.slew",
    "boom.cylinder": "DRAW_WIRES.boom",
    "stick.cylinder": "DRAW_WIRES.stick",
    "telescope.joint": "DRAW_WIRES.telescope",
}
VALVES = {axis: f"AUX_VALVE_{k}_COMMAND" for k, axis in enumerate(AXES)}


@dataclass(frozen=True)
class Flight:
    """The part of a run in which a path was followed.

    Args:
        path: name of the path, or the mode of another task.
        time: of the targets, (n,) [s].
        target, tip, tool: (n, 3) [m]; the tool is raised by its distance below the resting tip, so that it is compared with the
            target of the tip.
        joints: of the structure, (n, A) [rad or m].
        ended, why: of the run.
        log: folder of the recording; None in simulation.
        sources: share of the cycles by the source of their setpoints: ``track``, ``fallback``, ``hold``.
    """

    path: str
    time: Array
    target: Array
    tip: Array
    tool: Array
    joints: Array
    ended: str
    why: str
    log: Path | None = None
    sources: Mapping[str, float] = field(default_factory=dict)

    @property
    def error(self) -> Array:
        """Tool less target, (n, 3) [m]."""
        return self.tool - self.target

    def figures(self) -> dict[str, Any]:
        """RMSE and maximum of the tool's error per coordinate, and the maximum of the boom tip's [mm]."""
        if not len(self.time):
            return {"ended": self.ended, "why": self.why}
        return {
            "rmse_mm": (1e3 * np.sqrt(np.mean(self.error**2, axis=0))).tolist(),
            "max_mm": (1e3 * np.abs(self.error).max(axis=0)).tolist(),
            "tip_max_mm": (1e3 * np.abs(self.tip - self.target).max(axis=0)).tolist(),
            "ended": self.ended,
        }


def fly(
    machine: BenchRecipe,
    site: Path,
    logs: Path,
    registry: Registry,
    deployment: Deployment,
    task: Mapping[str, Any],
    seed: int,
) -> Flight:
    """Run ``task`` on ``machine`` over its CAN bus, on a simulated clock; log and take are a recording below ``logs``.

    Args:
        seed: of the noise of this run.
    """
    assembly = deployment.assembled(registry, site, task)
    line = BenchLine(LiveProcess(machine, DATABASE, seed))
    transport = CanTransport(CanSettings(DATABASE, SIGNALS, VALVES), bus=line, clock=line)
    versions = {version.kind: version.reference for version in assembly.loaded.versions}
    words = provenance({"machine": assembly.machine_file}, versions)
    offset_ns = time.time_ns() - line.now_ns()
    log = FlightLog(logs, assembly.machine_file, transport.axes, transport.signals, words, clock_ns=line.now_ns())
    cycles: list[Cycle] = []
    with log:
        outcome = assembly.loop(transport, log, Unattended(line)).run(cycles.append)
    truth = line.truth
    export_take(machine, truth, offset_ns, seed, log.folder)
    tip, tool = (np.column_stack([truth[f"{point}.{letter}"] for letter in "xyz"]) for point in ("ee", "tool"))
    joints = np.column_stack([truth[f"{axis}.joint"] for axis in AXES])
    return _flight(_name(task), assembly.dt, cycles, outcome, (truth["at_ns"], tip, tool, joints), log.folder)


def simulate(plant: Plant, site: Path, registry: Registry, deployment: Deployment, task: Mapping[str, Any]) -> Flight:
    """Run ``task`` on a plant from where the machine is parked: what the simulation predicts for the deployment."""
    assembly = deployment.assembled(registry, site, task)
    transport = SimulatedTransport(plant, assembly.middle, seed=0)
    cycles: list[Cycle] = []
    rows: list[tuple[Array, ...]] = []

    def watch(cycle: Cycle) -> None:
        cycles.append(cycle)
        lane = transport.truth
        rows.append((np.array(transport.now_ns()), lane.ee[0].copy(), lane.tool[0].copy(), lane.structure[0].copy()))

    outcome = assembly.loop(transport, _NoLog(), Unattended(transport)).run(watch)
    at, tip, tool, joints = (np.array(column, dtype=np.float64) for column in zip(*rows, strict=True))
    return _flight(_name(task), assembly.dt, cycles, outcome, (at, tip, tool, joints), None)


class _NoLog:
    """A recorder that keeps nothing."""

    fault = ""

    def record(self, cycle: Cycle) -> None:
        """Nothing."""


def _name(task: Mapping[str, Any]) -> str:
    return str(task["track"]["path"] if task["mode"] == "track" else task["mode"])


def _flight(
    name: str,
    dt: float,
    cycles: list[Cycle],
    outcome: RunOutcome,
    motion: tuple[Array, Array, Array, Array],
    log: Path | None,
) -> Flight:
    """The cycles with a target; ``motion``: times (m,) [ns], tip and tool (m, 3), joints (m, A) of the machine."""
    tracked = [cycle for cycle in cycles if cycle.state == "running" and np.isfinite(cycle.target).all()]
    due = np.array([cycle.at_ns + dt * SECOND for cycle in tracked])  # a target is that of the end of its cycle
    target = np.array([cycle.target for cycle in tracked]).reshape(-1, 3)
    at, tip, tool, joints = motion
    below = np.array([0.0, 0.0, tip[0, 2] - tool[0, 2]])  # at rest
    found = [np.column_stack([np.interp(due, at, column) for column in points.T]) for points in (tip, tool + below, joints)]
    counts = Counter(cycle.source for cycle in tracked)
    sources = {source: count / len(tracked) for source, count in counts.items()}
    return Flight(name, due / SECOND, target, *found, outcome.ended, outcome.why, log, sources)
