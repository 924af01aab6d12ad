"""Recordings at the edges of what numbers allow: forces that are zero, axes that stand still, few samples a second."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from sysid.datasets import Recording
from sysid.datasets.recording import Dataset
from sysid.errors import ExcitationError
from sysid.gap import find_gap, steps
from sysid.gap.data import Data
from sysid.gap.drift import DriftStrength
from sysid.gap.experiment import Planning
from sysid.gap.experiment.excitation_signal import ExcitationSignal
from sysid.gap.experiment.motions import MOTIONS
from sysid.gap.experiment.open_hypothesis import OpenHypothesis, plausible_model, relevant_size
from sysid.gap.experiment.proposal import Planner
from sysid.gap.prepare.case import stage_candidates
from sysid.gap.result import GapResult
from sysid.machine import machine_from_files
from sysid.plant import nominal_plant

ROLES = ("fit", "fit", "select", "held_out")
EXTRA = {"velocity": "gain = 0.5", "position": "gain = 1.0", "force": "gain = 1.0\ninertia = 1.3"}


def dataset_of(actuation: str, rate_hz: float, seconds: float, motion: str) -> Dataset:
    """One axis: ``at rest``, ``held`` under a command, ``driven`` to and fro, or a pendulum that ``swings`` freely."""
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
        if motion == "driven":
            swing, rate, push = (0.6 * 1.5**k * np.sin(1.5 * time + number + 0.5 * np.pi * k) for k in range(3))
            command = {"velocity": rate / 0.5, "position": swing, "force": 1.3 * push}[actuation]
        noise = 1e-4 * np.random.default_rng(number).standard_normal(len(time))
        table = pd.DataFrame({"time": time, "a.command": command, "a.joint": swing + noise})
        recordings.append(Recording(f"run-{number}", table, rate_hz))
    splits = {recording.name: role for recording, role in zip(recordings, ROLES, strict=True)}
    return Dataset.of(machine, recordings, splits)  # type: ignore[arg-type]


def searched(actuation: str, rate_hz: float, seconds: float, motion: str) -> GapResult:
    dataset = dataset_of(actuation, rate_hz, seconds, motion)
    return find_gap(dataset, nominal_plant(dataset.machine), planning=Planning())


@pytest.mark.parametrize("rate_hz", [10.0, 50.0])
@pytest.mark.parametrize("actuation", list(EXTRA))
def test_an_axis_at_rest_agrees_with_any_simulation(actuation: str, rate_hz: float) -> None:
    result = searched(actuation, rate_hz, 20.0, "at rest")
    assert (result.verdict, result.effects, result.missing) == ("insufficient_excitation", (), ())
    assert result.next_experiment[0].startswith("a did not move (")


def test_a_force_that_moves_nothing_is_no_agreement() -> None:
    result = searched("force", 10.0, 30.0, "held")
    assert (result.verdict, result.effects, result.missing) == ("insufficient_excitation", (), ())


@pytest.mark.parametrize(
    ("rate_hz", "seconds"),
    [(10.0, 30.0), *(pytest.param(*given, marks=pytest.mark.slow) for given in ((50.0, 30.0), (1000.0, 8.0)))],
)
def test_a_pendulum_that_nothing_drives(rate_hz: float, seconds: float) -> None:
    """Forces of zero give neither a unit of friction nor a floor of noise; its weight, which the simulation lacks, is a gap."""
    result = searched("force", rate_hz, seconds, "swings")
    assert result.verdict in ("insufficient_excitation", "unnamed")
    assert result.missing == ()


@pytest.mark.parametrize("rate_hz", [2.0, 10.0, *(pytest.param(rate, marks=pytest.mark.slow) for rate in (5.0, 100.0))])
@pytest.mark.parametrize("actuation", list(EXTRA))
def test_every_motion_is_planned_or_left_out_at_every_rate(actuation: str, rate_hz: float) -> None:
    """At 10 Hz, ten seconds of motion are too short to determine a force."""
    dataset = dataset_of(actuation, rate_hz, 60.0, "driven")
    plant = nominal_plant(dataset.machine)
    study = steps.open_study(dataset, plant)
    (stage,) = study.stages
    seen = Data(stage.problem, stage.split.seen, stage.sigma)
    candidate = next(c for c in stage_candidates(study.case, stage) if len(c.unknowns) == 1)
    calm = (DriftStrength(),)
    present = plausible_model(plant.vector(), candidate, candidate.unknowns, relevant_size(candidate), seen, calm)
    absent = plausible_model(plant.vector(), None, (), np.empty(0), seen, calm)
    hypothesis = OpenHypothesis("excitation", stage, (present, absent), calm)
    planner = Planner(study.case, plant, Planning())
    planned = [e for m in MOTIONS if not m.several for s in (10.0, 40.0) if (e := planner.excitation(m, (0,), s)) is not None]
    forecasts = [planner.forecast(excitation, hypothesis) for excitation in planned]
    assert all(forecast is None or forecast.nats > 0.0 for forecast in forecasts)


def test_a_force_that_is_logged_too_slowly_is_refused_with_what_it_lacks() -> None:
    with pytest.raises(ExcitationError, match="run-0: a: force and motion are not measured together; expected 100 samples"):
        searched("force", 1.0, 60.0, "driven")


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_motion_whose_start_is_no_number_is_left_out(value: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A network that was trained on too little gives no joint there."""
    dataset = dataset_of("velocity", 50.0, 20.0, "driven")
    plant = nominal_plant(dataset.machine)
    planner = Planner(steps.open_study(dataset, plant).case, plant, Planning())
    motion = next(m for m in MOTIONS if planner.excitation(m, (0,), 10.0) is not None)
    monkeypatch.setattr(ExcitationSignal, "start_values", lambda *_: {"a.joint": value})
    assert planner.excitation(motion, (0,), 20.0) is None
