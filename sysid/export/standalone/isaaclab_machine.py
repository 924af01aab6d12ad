"""An exported machine in Isaac Lab 2.x: its articulation, the actuator with its drive model, the event that draws parameters.

>>> robot = machine_cfg("{ENV_REGEX_NS}/Robot", physics_dt=sim_cfg.dt)
>>> events = EventsCfg()                 # each reset draws a row of posterior_samples.csv for each environment

Commands are those of ``machine.toml``, in the targets of the joints: velocity targets of velocity axes (-1 to 1), position
targets of position axes [rad or m], effort targets of force axes [N or N·m]. The drive model runs once a sample of the machine;
the implicit drives of the joints follow it. Velocity and position axes are sources of motion: no load deflects them.
"""

import csv
import json
from collections.abc import Sequence
from dataclasses import MISSING
from pathlib import Path
from typing import Any

import isaaclab.sim as sim_utils
import torch
from isaaclab.actuators import ImplicitActuator, ImplicitActuatorCfg
from isaaclab.assets import ArticulationCfg
from isaaclab.managers import EventTermCfg, SceneEntityCfg
from isaaclab.utils import configclass

FOLDER = Path(__file__).parent
#: Added to the joints that follow the drive model [kg or kg·m²], far above what the links load them with.
ARMATURE = 1e4


class DriveModelActuator(ImplicitActuator):  # type: ignore[misc, unused-ignore]
    """Joint targets from the drive model (``drive_model.pt``), one machine for each environment."""

    def __init__(self, cfg: Any, *args: Any, **kwargs: Any) -> None:
        super().__init__(cfg, *args, **kwargs)
        self.about = json.loads(Path(cfg.description).read_text("utf-8"))
        self.model: Any = _load(str(cfg.model), self._device)
        axes = self.about["axes"]
        self.columns = torch.tensor([self.joint_names.index(axis["joint"]) for axis in axes], device=self._device)
        self.kinds = [axis["actuation"] for axis in axes]
        self.theta = self.model.theta(self._num_envs)
        self.offsets = self.theta.new_tensor([axis["offset"] for axis in axes])
        self.begun = torch.zeros(self._num_envs, dtype=torch.bool, device=self._device)
        self.samples, self.sampled = _samples(self.about["posterior_columns"], self.theta)
        self.phase = 0
        self.state: Any = None
        self.signals: dict[str, Any] = {}
        self.before: Any = None
        self.target: Any = None

    def reset(self, env_ids: Sequence[int] | None = None) -> None:
        """The machines of these environments begin at rest where their joints are at the next step."""
        self.begun[slice(None) if env_ids is None else env_ids] = False

    def draw(self, env_ids: Any) -> None:
        """Parameters of these environments from rows of the joint samples."""
        ids = (
            torch.arange(self._num_envs, device=self._device) if env_ids is None else torch.as_tensor(env_ids).to(self._device)
        )
        if len(self.samples):
            rows = torch.randint(len(self.samples), (len(ids),), device=self._device)
            self.theta[ids[:, None], self.sampled[None]] = self.samples[rows]

    def compute(self, control_action: Any, joint_pos: Any, joint_vel: Any) -> Any:
        """Replace the targets of the joints by the motion of the drive model."""
        places = joint_pos[:, self.columns].to(self.theta.dtype)
        commands = torch.stack([self._command(control_action, k) for k in range(len(self.kinds))], dim=1)
        self._begin(places, commands)
        if self.phase == 0:
            self.state, self.signals = self.model(self.theta, self.state, commands)
            self.before, self.target = self.target, self.signals["structure"] - self.offsets
        self.phase += 1
        count = self.cfg.steps_per_sample
        moved = self.target - self.before
        now = self.before + moved * (self.phase / count)
        speed = moved / self.about["sample"]
        self.phase %= count
        control_action.joint_positions = self._placed(control_action.joint_positions, now)
        control_action.joint_velocities = self._placed(control_action.joint_velocities, speed)
        control_action.joint_efforts = self._placed(control_action.joint_efforts, torch.zeros_like(now))
        return super().compute(control_action, joint_pos, joint_vel)

    def readings(self) -> dict[str, Any]:
        """The last sample as the sensors read it: signal → (environments,)."""
        found: dict[str, Any] = self.model.readings(self.theta, self.signals)
        return found

    def _begin(self, places: Any, commands: Any) -> None:
        new = ~self.begun[:, None]
        if not bool(new.any()):
            return
        joints = places + self.offsets - self._drawn_offsets()  # at the sensors: those of the asset have the plant's offsets
        state, signals = self.model.begin(self.theta, joints, self.model.drives(self.theta, joints), torch.zeros_like(commands))
        target = signals["structure"] - self.offsets
        if self.state is None:
            self.state, self.before, self.target = state, target, target
        self.state = torch.where(new, state, self.state)
        self.before, self.target = torch.where(new, target, self.before), torch.where(new, target, self.target)
        self.begun[:] = True

    def _drawn_offsets(self) -> Any:
        columns = [axis["offset_column"] for axis in self.about["axes"]]
        return torch.stack([self.theta[:, k] if k >= 0 else torch.zeros_like(self.theta[:, 0]) for k in columns], dim=1)

    def _command(self, action: Any, k: int) -> Any:
        targets = {"velocity": "joint_velocities", "position": "joint_positions", "force": "joint_efforts"}
        return getattr(action, targets[self.kinds[k]])[:, self.columns[k]].to(self.theta.dtype)

    def _placed(self, targets: Any, values: Any) -> Any:
        found = targets.clone()  # the targets are the user's buffers
        found[:, self.columns] = values.to(found.dtype)
        return found


def _load(path: str, device: str) -> Any:
    jit: Any = torch.jit
    return jit.load(path, map_location=device)


def _samples(columns: dict[str, list[int]], theta: Any) -> tuple[Any, Any]:
    """Joint samples (count, k), and their columns of the parameters (k,)."""
    path = FOLDER / "posterior_samples.csv"
    rows: list[list[float]] = []
    places: list[tuple[int, int]] = []  # column of the file, column of the parameters
    if path.is_file():
        with path.open(newline="", encoding="utf-8") as file:
            head, *lines = csv.reader(file)
        names = [name.rpartition(" [")[0] for name in head]
        places = [(k, at) for k, name in enumerate(names) for at in columns.get(name, [])]
        rows = [[float(line[k]) for k, _ in places] for line in lines]
    values = theta.new_tensor(rows).reshape(len(rows) if places else 0, len(places))
    return values, torch.tensor([at for _, at in places], dtype=torch.int64, device=theta.device)


@configclass
class DriveModelActuatorCfg(ImplicitActuatorCfg):  # type: ignore[misc, unused-ignore]
    """Configuration of the actuator.

    ``steps_per_sample``: steps of the physics in a sample of the machine.
    """

    class_type: type = DriveModelActuator
    model: str = str(FOLDER / "drive_model.pt")
    description: str = str(FOLDER / "isaaclab_machine.json")
    steps_per_sample: int = MISSING  # type: ignore[assignment]


def actuator_cfg(physics_dt: float) -> Any:
    """The actuator of all axes for steps of the physics of ``physics_dt`` [s].

    Raises:
        ValueError: a sample of the machine is not a whole number of steps.
    """
    about = json.loads((FOLDER / "isaaclab_machine.json").read_text("utf-8"))
    count = round(about["sample"] / physics_dt)
    if count < 1 or abs(count * physics_dt - about["sample"]) > 1e-6 * about["sample"]:
        sample = f"a sample of the machine ({about['sample']:g} s)"
        raise ValueError(f"physics_dt of {physics_dt:g} s; expected a step of which {sample} is a whole number")
    return DriveModelActuatorCfg(
        joint_names_expr=[axis["joint"] for axis in about["axes"]],
        steps_per_sample=count,
        armature=ARMATURE,
        stiffness=ARMATURE / physics_dt**2,  # critically damped, within a few steps
        damping=2.0 * ARMATURE / physics_dt,
    )


def machine_cfg(prim_path: str, physics_dt: float) -> Any:
    """The machine as an articulation with a fixed base."""
    drive = sim_utils.UrdfConverterCfg.JointDriveCfg
    return ArticulationCfg(
        prim_path=prim_path,
        spawn=sim_utils.UrdfFileCfg(
            asset_path=str(FOLDER / "robot.urdf"),
            fix_base=True,
            merge_fixed_joints=False,
            joint_drive=drive(gains=drive.PDGainsCfg(stiffness=None, damping=None)),
        ),
        actuators={"drives": actuator_cfg(physics_dt)},
    )


def draw_drive_parameters(env: Any, env_ids: Any, asset_cfg: Any, group: str = "drives") -> None:
    """Event: joint draws of the drives' parameters for environments that are reset."""
    env.scene[asset_cfg.name].actuators[group].draw(env_ids)


@configclass
class EventsCfg:
    """Randomisation of the drives from the joint distribution of their parameters."""

    drive_parameters = EventTermCfg(
        func=draw_drive_parameters, mode="reset", params={"asset_cfg": SceneEntityCfg("robot"), "group": "drives"}
    )
