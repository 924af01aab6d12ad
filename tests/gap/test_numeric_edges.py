"""Recordings at the edges of what numbers allow: forces that are zero, axes that stand still, few samples a second."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from sysid.datasets import Recording
from sysid.datasets.recording import Dataset
from sysid.gap import find_gap
from sysid.gap.experiment import Planning
from sysid.gap.result import GapResult
from sysid.machine import machine_from_files
from sysid.plant import nominal_plant

ROLES = ("fit", "fit", "select", "held_out")
EXTRA = {"velocity": "gain = 0.5", "position": "gain = 1.0", "force": "gain = 1.0\ninertia = 1.3"}


def searched(actuation: str, rate_hz: float, seconds: float, motion: str) -> GapResult:
    """The result for one axis: ``at rest`` without a command, ``held`` under one, or a pendulum that ``swings`` without one."""
    text = (
        f'schema = 1\nname = "edge"\nrate_hz = {rate_hz}\n[[axes]]\nname = "a"\njoint = "a_joint"\nactuation = "{actuation}"\n'
        f'drives = "joint"\nlimits = [-2.0, 2.0]\n{EXTRA[actuation]}\n'
    )
    machine = machine_from_files({"machine.toml": text}, "edge")
    recordings = []
    for number in range(len(ROLES)):
        time = np.arange(round(seconds * rate_hz)) / rate_hz
        swing = 0.8 * np.exp(-0.1 * time) * np.cos(3.0 * time + number) if motion == "swings" else np.zeros(len(time))
        command = np.sin(0.4 * np.pi * time + number) if motion == "held" else np.zeros(len(time))
        noise = 1e-4 * np.random.default_rng(number).standard_normal(len(time))
        table = pd.DataFrame({"time": time, "a.command": command, "a.joint": swing + noise})
        recordings.append(Recording(f"run-{number}", table, rate_hz))
    splits = {recording.name: role for recording, role in zip(recordings, ROLES, strict=True)}
    return find_gap(Dataset.of(machine, recordings, splits), nominal_plant(machine), planning=Planning())  # type: ignore[arg-type]


@pytest.mark.parametrize("rate_hz", [10.0, 50.0])
@pytest.mark.parametrize("actuation", list(EXTRA))
def test_an_axis_at_rest_agrees_with_any_simulation(actuation: str, rate_hz: float) -> None:
    result = searched(actuation, rate_hz, 20.0, "at rest")
    assert (result.verdict, result.effects, result.missing) == ("insufficient_excitation", (), ())
    assert result.next_experiment[0].startswith("a did not move (")


def test_a_force_that_moves_nothing_is_no_agreement() -> None:
    result = searched("force", 10.0, 30.0, "held")
    assert (result.verdict, result.effects, result.missing) == ("insufficient_excitation", (), ())


@pytest.mark.parametrize(("rate_hz", "seconds"), [(10.0, 30.0), (50.0, 30.0), (1000.0, 8.0)])
def test_a_pendulum_that_nothing_drives(rate_hz: float, seconds: float) -> None:
    """Forces of zero give neither a unit of friction nor a floor of noise; its weight, which the simulation lacks, is a gap."""
    result = searched("force", rate_hz, seconds, "swings")
    assert result.verdict in ("insufficient_excitation", "unnamed")
    assert result.missing == ()
