"""One recording of the simulated test bench: the true motion, and the logs of its computer and of the capture system."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from simulated_bench.capture import Capture, capture
from simulated_bench.machine import Truth, run_machine
from simulated_bench.recipe import BenchRecipe, RecordingSettings
from simulated_bench.sensors import read_machine

Array = npt.NDArray[np.float64]

#: Recordings are taken this far apart; the machine's clock runs on between them [s].
BETWEEN_RECORDINGS = 600.0


@dataclass(frozen=True)
class MachineLog:
    """Measurements and commands of the machine's computer, once per controller cycle.

    Args:
        stamps: when it was measured or sent, on the machine's clock (n,) [ns].
        published, logged: when each message was published and logged, (n, 3) [ns], columns command, wires, slew.
        command: (n, 4) for slew, boom, stick, telescope. wires: (n, 3) [m] for ``WIRED``. slew: (n,) [rad].
    """

    stamps: npt.NDArray[np.int64]
    published: npt.NDArray[np.int64]
    logged: npt.NDArray[np.int64]
    command: Array
    wires: Array
    slew: Array


@dataclass(frozen=True)
class Run:
    """A simulated recording. ``start_ns`` is the machine's clock at ``truth.time == 0``."""

    recipe: BenchRecipe
    recording: RecordingSettings
    truth: Truth
    log: MachineLog
    capture: Capture
    start_ns: int


def simulate(recipe: BenchRecipe, recording: str | RecordingSettings) -> Run:
    """Simulate one recording of ``recipe``; the same recipe and recording give the same run.

    Raises:
        SettingsError: the recipe has no recording of that name.
    """
    chosen = recipe.recording(recording) if isinstance(recording, str) else recording
    # Separate random streams, so that a change of one feature does not change the noise of the others.
    motion, sensors, camera, network = (np.random.default_rng([recipe.seed, chosen.seed, part]) for part in range(4))
    truth = run_machine(recipe, chosen, motion)
    names = [each.name for each in recipe.recordings]
    index = names.index(chosen.name) if chosen.name in names else 0
    start_ns = recipe.controller.epoch_ns + round(index * BETWEEN_RECORDINGS * 1e9)
    log = _read_machine(recipe, chosen, truth, start_ns, sensors, network)
    return Run(recipe, chosen, truth, log, capture(recipe, chosen, truth, camera), start_ns)


def _read_machine(
    recipe: BenchRecipe,
    recording: RecordingSettings,
    truth: Truth,
    start_ns: int,
    sensors: np.random.Generator,
    network: np.random.Generator,
) -> MachineLog:
    controller = recipe.controller
    step = truth.time[1] - truth.time[0]
    ticks = np.arange(0, len(truth.time), round(1.0 / (controller.rate * step)))
    if recording.is_calibration:
        # The routine triggers the recorder, at a lower rate and only while a pose is held.
        thinned = ticks[:: max(round(controller.rate / recipe.routine.log_rate), 1)]
        ticks = thinned[np.searchsorted(truth.still.ravel(), truth.time[thinned]) % 2 == 1]
    wires, slew = read_machine(recipe, truth.drive[ticks], truth.joint[ticks], sensors)
    stamps = start_ns + np.round(truth.time[ticks] * 1e9).astype(np.int64)
    shape = (len(ticks), 3)
    published = controller.publish_delay + controller.jitter * network.exponential(size=shape)
    arrived = published + controller.transport_delay + controller.jitter * network.exponential(size=shape)
    return MachineLog(
        stamps=stamps,
        published=stamps[:, None] + np.round(published * 1e9).astype(np.int64),
        logged=stamps[:, None] + np.round(arrived * 1e9).astype(np.int64),
        command=truth.command[ticks],
        wires=wires,
        slew=slew,
    )
