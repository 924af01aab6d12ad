"""The shipped file for Isaac Lab, against doubles with the documented interface (2.x): constructor, ``compute``, ``reset``."""

from __future__ import annotations

import ast
import json
import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_drive_model import probe_plant
from test_torchscript import JOINTS, by_script, commands_of, torch

from sysid.export.drive_module import load_module
from sysid.export.isaaclab import ABOUT, FILE, MODEL, IsaacLabTarget
from sysid.export.posterior import posterior, write_posterior
from sysid.export.torchscript.model import load_script
from sysid.machine import KnownEffect
from sysid.plant import Plant, PlantNumber, Uncertainty
from sysid.testing.probe import RATE_HZ

#: Of PyTorch about the format.
pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit:DeprecationWarning")
#: Joint order of the articulation, which need not be that of the machine.
ORDER = (3, 0, 2, 1)


@dataclass
class ImplicitActuatorCfg:
    class_type: Any = None
    joint_names_expr: Any = None
    stiffness: Any = None
    damping: Any = None
    armature: Any = None


class ImplicitActuator:
    def __init__(
        self, cfg: Any, joint_names: list[str], joint_ids: Any, num_envs: int, device: str, **properties: Any
    ) -> None:  # fmt: skip
        self.cfg, self._joint_names, self._num_envs, self._device = cfg, joint_names, num_envs, device

    @property
    def joint_names(self) -> list[str]:
        return self._joint_names

    def compute(self, control_action: Any, joint_pos: Any, joint_vel: Any) -> Any:
        return control_action


@dataclass
class Record:
    """Keyword arguments of a configuration."""

    values: dict[str, Any] = field(default_factory=dict)


def record(**values: Any) -> Record:
    return Record(values)


def doubles() -> dict[str, ModuleType]:
    joint_drive = type("JointDriveCfg", (), {"PDGainsCfg": staticmethod(record), "__init__": lambda self, **kw: None})
    contents: dict[str, dict[str, Any]] = {
        "isaaclab": {},
        "isaaclab.sim": {"UrdfConverterCfg": SimpleNamespace(JointDriveCfg=joint_drive), "UrdfFileCfg": record},
        "isaaclab.actuators": {"ImplicitActuator": ImplicitActuator, "ImplicitActuatorCfg": ImplicitActuatorCfg},
        "isaaclab.assets": {"ArticulationCfg": record},
        "isaaclab.managers": {"EventTermCfg": record, "SceneEntityCfg": lambda name: SimpleNamespace(name=name)},
        "isaaclab.utils": {"configclass": dataclass(kw_only=True)},
    }
    found = {}
    for name, values in contents.items():
        found[name] = ModuleType(name)
        vars(found[name]).update(values)
        if "." in name:
            setattr(found["isaaclab"], name.partition(".")[2], found[name])
    return found


def uncertain() -> Plant:
    places = PlantNumber("input_delay", "boom", None, "delay"), PlantNumber("first_order_lag", "boom", None, "time_constant")
    plant = probe_plant(
        KnownEffect("input_delay", "boom", {"delay": 0.05}),
        KnownEffect("first_order_lag", "boom", {"time_constant": 0.08}),
        KnownEffect("joint_offset", "boom", {"offset": 0.05}),
    )
    return plant.with_uncertainty(Uncertainty(places, np.array([[1e-6, -0.9e-6], [-0.9e-6, 1e-6]])))


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    for name, module in doubles().items():
        monkeypatch.setitem(sys.modules, name, module)
    plant = uncertain()
    IsaacLabTarget().write(plant, RATE_HZ, tmp_path)
    write_posterior(posterior(plant, 50, 0), tmp_path)
    return load_module(tmp_path / FILE)


def actuator(machine: Any, environments: int, physics_dt: float) -> Any:
    cfg = machine.actuator_cfg(physics_dt)
    names = [cfg.joint_names_expr[k] for k in ORDER]
    return cfg.class_type(cfg=cfg, joint_names=names, joint_ids=slice(None), num_envs=environments, device="cpu")


def action(commands: Any) -> Any:
    """Each command in the target of its kind of axis, in the articulation's order."""
    kinds = {"joint_velocities": (0, 1), "joint_positions": (3,), "joint_efforts": (2,)}
    targets = {name: torch.zeros(len(commands), 4) for name in kinds}
    for name, axes in kinds.items():
        for k in axes:
            targets[name][:, ORDER.index(k)] = commands[:, k].float()
    return SimpleNamespace(**targets)


def test_the_joints_follow_the_drive_model(machine: Any, tmp_path: Path) -> None:
    """Two steps of the physics in a sample: the second ends where the plant is, the first half-way."""
    plant = uncertain()
    commands = torch.tensor(commands_of(plant)[:150])
    driver = actuator(machine, 2, 0.005)
    module = load_script(tmp_path / MODEL)
    theta = module.theta(2)
    joints = torch.tensor(np.tile(JOINTS, (2, 1)))
    state, signals = module.begin(theta, joints, module.drives(theta, joints), torch.zeros(2, 4, dtype=torch.float64))
    offsets = torch.tensor([axis["offset"] for axis in json.loads((tmp_path / ABOUT).read_text("utf-8"))["axes"]])
    before, at, moved = signals["structure"] - offsets, joints, 0.0
    for command in commands:
        both = command[None].repeat(2, 1)
        state, signals = module(theta, state, both)
        after = signals["structure"] - offsets
        for expected in (0.5 * (before + after), after):
            given = action(both)
            kept = {name: values.clone() for name, values in vars(given).items()}
            targets = dict(vars(given))
            found = driver.compute(given, at[:, list(ORDER)].float(), torch.zeros(2, 4))
            assert all(torch.equal(targets[name], values) for name, values in kept.items()), "the user's buffers are kept"
            placed = found.joint_positions[:, [ORDER.index(k) for k in range(4)]].double()
            torch.testing.assert_close(placed, expected, rtol=0.0, atol=1e-6)
            assert not found.joint_efforts.any()
            at = placed
        speed = found.joint_velocities[:, [ORDER.index(k) for k in range(4)]].double()
        torch.testing.assert_close(speed, (after - before) * RATE_HZ, rtol=0.0, atol=1e-5)
        moved, before = max(moved, float((after - joints).abs().max())), after
    assert moved > 0.1
    assert set(driver.readings()) >= {"boom.cylinder", "boom.joint"}


def test_a_reset_begins_at_the_joints_of_its_environments(machine: Any) -> None:
    driver = actuator(machine, 2, 0.01)
    at = torch.tensor(np.tile(JOINTS, (2, 1)))[:, list(ORDER)].float()
    full = torch.ones(2, 4, dtype=torch.float64)
    for _ in range(50):
        found = driver.compute(action(full), at, torch.zeros(2, 4))
    driver.reset([1])
    there = found.joint_positions.clone()
    found = driver.compute(action(full), at, torch.zeros(2, 4))
    slew = ORDER.index(0)
    assert abs(float(found.joint_positions[1, slew] - at[1, slew])) < 0.02, "the second begins again"
    assert float(there[0, slew] - at[0, slew]) > 0.1, "the first has gone on"
    assert float(found.joint_positions[0, slew]) >= float(there[0, slew])


def test_a_drawn_offset_does_not_move_the_joints_at_the_start(machine: Any) -> None:
    """Where the joint of the asset is, the structure is; its sensor reads another value."""
    driver = actuator(machine, 2, 0.01)
    column = list(driver.model.parameter_names).index("joint_offset.boom.offset")
    driver.theta[1, column] = 0.15
    at = torch.tensor(np.tile(JOINTS, (2, 1)))[:, list(ORDER)].float()
    found = driver.compute(action(torch.zeros(2, 4, dtype=torch.float64)), at, torch.zeros(2, 4))
    boom = ORDER.index(1)
    np.testing.assert_allclose(found.joint_positions[:, boom], JOINTS[1], atol=1e-4)
    read = driver.readings()["boom.joint"]
    assert float(read[0] - read[1]) == pytest.approx(0.1, abs=1e-4)


def test_the_event_draws_rows_of_the_joint_samples(machine: Any) -> None:
    driver = actuator(machine, 300, 0.01)
    term = machine.EventsCfg().drive_parameters.values
    assert term["mode"] == "reset"
    environment = SimpleNamespace(scene={"robot": SimpleNamespace(actuators={"drives": driver})})
    before = driver.theta.clone()
    term["func"](environment, torch.arange(200), **term["params"])
    assert torch.equal(driver.theta[200:], before[200:]), "the others keep theirs"
    columns = [list(driver.model.parameter_names).index(f"{name}") for name in
               ("input_delay.boom.delay", "first_order_lag.boom.time_constant")]  # fmt: skip
    drawn = driver.theta[:200][:, columns].numpy()
    rows = {tuple(row) for row in driver.samples.numpy()}
    assert {tuple(row) for row in drawn} <= rows, "whole rows"
    assert np.corrcoef(drawn.T)[0, 1] < -0.7


def test_a_sample_is_a_whole_number_of_steps(machine: Any) -> None:
    assert machine.actuator_cfg(0.0025).steps_per_sample == 4
    with pytest.raises(
        ValueError, match=r"physics_dt of 0\.003 s; expected a step of which a sample of the machine \(0\.01 s\)"
    ):
        machine.actuator_cfg(0.003)


def test_the_articulation(machine: Any, tmp_path: Path) -> None:
    made = machine.machine_cfg("{ENV_REGEX_NS}/Robot", 0.005).values
    assert made["spawn"].values["asset_path"] == str(tmp_path / "robot.urdf")
    assert made["spawn"].values["fix_base"]
    assert list(made["actuators"]) == ["drives"]


def test_only_documented_names_are_imported() -> None:
    """Against the reference of Isaac Lab 2.3: isaaclab.actuators, .assets, .managers, .sim, .utils."""
    source = Path(__file__).parents[2] / "sysid/export/standalone" / FILE
    imported = {
        (node.module, name.name)
        for node in ast.walk(ast.parse(source.read_text("utf-8")))
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("isaaclab")
        for name in node.names
    }
    assert imported == {
        ("isaaclab.actuators", "ImplicitActuator"),
        ("isaaclab.actuators", "ImplicitActuatorCfg"),
        ("isaaclab.assets", "ArticulationCfg"),
        ("isaaclab.managers", "EventTermCfg"),
        ("isaaclab.managers", "SceneEntityCfg"),
        ("isaaclab.utils", "configclass"),
    }


def test_the_script_is_that_of_the_plant() -> None:
    """Commands of the probe move every axis, so that a wrong joint order could not pass."""
    from sysid.export.torchscript.model import script_of

    module = script_of(uncertain(), RATE_HZ)
    signals = by_script(module, module.theta(1), commands_of(uncertain()))
    assert (np.ptp([values["structure"][0].numpy() for values in signals], axis=0) > 1e-2).all()
