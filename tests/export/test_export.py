"""``sysid export``: what it writes, what it refuses, and the joint distribution of the parameters."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from command_line import run
from plant_data import arm, arm_inputs, measured

from sysid.datasets.recording import Dataset, Recording
from sysid.errors import SettingsError
from sysid.export.export import PAGE, REPLAY, TARGETS, export_plant, target_named
from sysid.export.posterior import RANGES, SAMPLES, WARNING, posterior, write_posterior
from sysid.export.replay import replay
from sysid.machine import KnownEffect
from sysid.plant import Plant, PlantNumber, Uncertainty, nominal_plant
from sysid.workspace import open_workspace

Array = npt.NDArray[np.float64]
LAG = KnownEffect("first_order_lag", "boom", {"time_constant": 0.08})
DELAY = KnownEffect("input_delay", "boom", {"delay": 0.05})
#: Targets whose simulator is not installed.
NOT_RUN = ("sdf",)
#: Targets that have no part for a swinging tool.
TABLES = ("lut", "simulink")
SWAY = KnownEffect("gripper_sway", "tool", {"length": 0.25, "damping_ratio": 0.05})


def repaired() -> Plant:
    """A plant whose delay and lag are known together, with opposite errors."""
    places = PlantNumber("input_delay", "boom", None, "delay"), PlantNumber("first_order_lag", "boom", None, "time_constant")
    covariance = np.array([[1e-6, -0.9e-6], [-0.9e-6, 1e-6]])
    plant = nominal_plant(arm())
    for effect in (LAG, DELAY, SWAY):
        plant = plant.with_effect(effect)
    return plant.with_uncertainty(Uncertainty(places, covariance))


def dataset(plant: Plant) -> Dataset:
    recordings = [replace(measured(plant, arm_inputs(f"r{k}", 6.0, k), k), name=f"r{k}") for k in range(2)]
    return Dataset.of(plant.machine, recordings, {"r0": "fit", "r1": "held_out"})


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_writes_files_with_their_replay(target: object, tmp_path: Path) -> None:
    plant, chosen = repaired(), target_named(target.name)  # type: ignore[attr-defined]
    made = export_plant(plant, dataset(plant), chosen, tmp_path / "out", force=chosen.name in TABLES)
    assert {entry.name for entry in made.folder.iterdir()} == set(made.files)
    if made.replay is None:
        assert chosen.name in NOT_RUN
        assert "Not run here" in (made.folder / PAGE).read_text("utf-8")
        return
    assert made.replay.recordings == ("r1",), "what no fit has used"
    stored = json.loads((made.folder / REPLAY).read_text("utf-8"))
    assert stored["replay"]["rows"][0]["signal"] == "slew.joint"
    page = (made.folder / PAGE).read_text("utf-8")
    for text in ("| Valve lag (`first_order_lag`) | boom | time_constant 0.08 s |", "`tool.z`", "Units are SI", WARNING):
        assert text in page
    if chosen.name in TABLES:
        assert made.lacking == ("gripper_sway on tool",)
    else:
        assert made.replay.agrees


def test_an_export_that_disagrees_is_refused(tmp_path: Path) -> None:
    plant = repaired()
    with pytest.raises(SettingsError, match=r"tool\.[xyz] differs from the plant by .*gripper_sway on tool.*--force"):
        export_plant(plant, dataset(plant), target_named("lut"), tmp_path / "out")
    assert list(tmp_path.iterdir()) == [], "nothing is left"


def test_what_disagrees_is_left_to_the_drive_model(tmp_path: Path) -> None:
    """The pendulum of MuJoCo is not that of the plant where a servo jumps: the export is repeated without it."""
    plant = repaired()
    data, target = dataset(plant), target_named("mjcf")
    target.write(plant, data.machine.rate_hz, tmp_path)
    simulation = target.simulation(plant, tmp_path)
    assert simulation is not None
    assert not replay(plant, simulation, data.with_role("held_out"), {}).agrees
    made = export_plant(plant, data, target, tmp_path / "out")
    assert made.replay is not None
    assert made.replay.agrees
    assert "| Swinging tool (`gripper_sway`) | tool | length 0.25 m; damping_ratio 0.05 | by plugin |" in (
        (made.folder / PAGE).read_text("utf-8")
    )


def test_an_earlier_export_is_replaced_and_other_files_are_not(tmp_path: Path) -> None:
    plant = repaired()
    for _ in range(2):
        export_plant(plant, dataset(plant), target_named("json"), tmp_path / "out")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/notes.txt").write_text("keep", "utf-8")
    with pytest.raises(SettingsError, match="a folder with other files"):
        export_plant(plant, dataset(plant), target_named("json"), tmp_path / "mine")
    assert (tmp_path / "mine/notes.txt").read_text("utf-8") == "keep"


def test_samples_are_joint_and_ranges_warn(tmp_path: Path) -> None:
    plant = repaired()
    found = posterior(plant, 4000, 0)
    assert found.columns == ("input_delay.boom.delay", "first_order_lag.boom.time_constant")
    assert found.correlation[0, 1] == pytest.approx(-0.9, abs=0.03)
    assert write_posterior(found, tmp_path) == (SAMPLES, RANGES)
    with (tmp_path / SAMPLES).open(encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["input_delay.boom.delay [s]", "first_order_lag.boom.time_constant [s]"]
    assert np.corrcoef(np.array(rows[1:], dtype=float).T)[0, 1] == pytest.approx(-0.9, abs=0.03)
    stored = json.loads((tmp_path / RANGES).read_text("utf-8"))
    assert stored["warning"] == WARNING
    low, high = stored["parameters"][0]["distribution_params"]
    assert (low, high) == (pytest.approx(0.05 - 1.96e-3, abs=2e-4), pytest.approx(0.05 + 1.96e-3, abs=2e-4))


def test_no_uncertainty_no_files(tmp_path: Path) -> None:
    assert write_posterior(posterior(nominal_plant(arm()), 10, 0), tmp_path) == ()
    assert list(tmp_path.iterdir()) == []


def test_unknown_target() -> None:
    with pytest.raises(SettingsError, match=r"no target 'mjfc'; expected 'mjcf'\?"):
        target_named("mjfc")


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From a workspace: the dataset is that of the plant's lineage."""
    from sysid.datasets import ingest

    plant = repaired()
    for k in range(3):
        folder = tmp_path / f"logs/r{k}"
        folder.mkdir(parents=True)
        source: Recording = measured(plant, arm_inputs(f"r{k}", 6.0, k), k)
        source.table.to_csv(folder / "log.csv", index=False)
    for name, text in plant.machine.files().items():
        (tmp_path / name).write_text(text, "utf-8")
    made = ingest([tmp_path / "logs"], tmp_path / "ws", tmp_path / "machine.toml", name="arm")
    registry = open_workspace(tmp_path / "ws").models
    registry.register("arm", "plant", plant.to_files(), {"dataset": made.reference})
    workspace = ("--workspace", tmp_path / "ws")
    assert run(*workspace, "export", "arm@1", "--to", "mjcf", "--out", tmp_path / "out", "--json", tmp_path / "r.json") == 0
    shown = capsys.readouterr().out
    assert "arm@1 for mjcf" in shown
    assert "ee.x" in shown
    assert json.loads((tmp_path / "r.json").read_text("utf-8"))["replay"]["agrees"]
    assert run(*workspace, "export", "arm", "--to", "lut", "--out", tmp_path / "lut") == 2
    assert "gripper_sway on tool" in capsys.readouterr().err
    assert run(*workspace, "export", "nothing", "--to", "mjcf", "--out", tmp_path / "x") == 2
