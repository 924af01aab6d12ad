"""The recipe of a training. Defaults: the paper's; choices that it leaves open: ``docs/guide/training.md``."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from sysid.config import Strict, parse_settings, read_toml
from sysid.errors import SettingsError
from sysid.names import check_name
from sysid_rl.train.residual_observation import Residual
from sysid_rl.train.task import Task


@dataclass(frozen=True)
class Setting(Strict):
    """The environment.

    Args:
        copies: of the machine in parallel.
        full: joint setpoints pass cylinder controllers, valves and plant; else joints follow at once, as in the paper.
        feedback, repeat: of :class:`sysid_rl.train.driven.DrivenEnvironment`, on the full path only; a trained policy acts at
            every sample.
        task: steps of an episode and its rewards.
        residual: the policy offsets the setpoints of inverse kinematics to bring a hanging tool to rest, on the full path only
            (:mod:`sysid_rl.train.residual`); each offset is held for ``repeat`` samples, also after the training.
        start_swing: greatest distance of the tool from its rest at the beginning of an episode [m], on the full path only.
        spread: distance of targets, as a share of the way from the start to a random pose.
        curriculum: share of the training in which the distance of targets grows, from a tenth of the way to anywhere within
            reach; 0: they are anywhere from the start, as in the paper.
    """

    copies: int = 1
    full: bool = False
    feedback: Literal["static", "plant"] = "static"
    repeat: int = 1
    task: Task = field(default_factory=Task)
    residual: Residual | None = None
    spread: float = 1.0
    start_swing: float = 0.0
    curriculum: float = 0.0


@dataclass(frozen=True)
class Exploration(Strict):
    """The exploring actions.

    Args:
        candidates: actions drawn around the actor's, of which the one nearest to the target by the forward model is executed;
            one is plain DDPG, without feedback.
        sigma, theta, time_step: σ, θ and dt of :class:`sysid_rl.train.noise.OrnsteinUhlenbeck`, in half ranges of the action.
            With dt = 1, σ is the increment of a step; Stable-Baselines3 has dt = 0.01.
        sigma_end: final σ of a geometric decay; None: σ is constant.
        random_steps: first steps of each copy, with actions from the whole range.
    """

    candidates: int = 10
    sigma: float = 0.1
    theta: float = 0.15
    time_step: float = 1.0
    sigma_end: float | None = None
    random_steps: int = 0


@dataclass(frozen=True)
class Networks(Strict):
    """Perceptrons with ReLU.

    Args:
        actor, critic: hidden layers.
        critic_head: ``value``: the last layer is Q. ``distance``: it is a point p and an offset b, Q = b − ‖p − target‖, the
            form of the reward. ``offset``: the same with p relative to the end effector, for the full path.
        critic_features: ``plain``, or ``sincos``: additional inputs sine and cosine of the action's angles.
    """

    actor: tuple[int, ...] = (400, 300)
    critic: tuple[int, ...] = (400, 300)
    critic_head: Literal["value", "distance", "offset"] = "value"
    critic_features: Literal["plain", "sincos"] = "plain"


@dataclass(frozen=True)
class Learning(Strict):
    """The updates.

    Args:
        episodes: of all copies together, each of ``setting.task.steps`` steps.
        updates, every: ``updates`` after every ``every`` steps of all copies.
        start: transitions in the buffer before the first update.
        buffer: transitions kept.
        batch: transitions of an update.
        discount: γ. Where every setpoint is reached within a step, γ = 0 has the same optimal policy as any other.
        tau: τ of the target networks.
        actor_rate, critic_rate: of Adam.
        schedule: ``cosine``: both rates fall to zero by the end.
        hindsight: share of a batch whose targets are replaced and rewards recomputed (the reward is a function of end
            effector and target): half of them by points near the reached end effector, half by end effectors of other
            transitions.
        hindsight_near: standard deviation of the former [m].
    """

    episodes: int = 1500
    updates: int = 1
    every: int = 1
    start: int = 1024
    buffer: int = 1_000_000
    batch: int = 1024
    discount: float = 0.99
    tau: float = 1e-3
    actor_rate: float = 1e-3
    critic_rate: float = 1e-3
    schedule: Literal["constant", "cosine"] = "constant"
    hindsight: float = 0.0
    hindsight_near: float = 0.05


@dataclass(frozen=True)
class TrainingRecipe(Strict):
    """The whole recipe.

    Args:
        name: of the policy in the registry.
        plant, forward: model versions: ``name``, ``name@3`` or ``name@champion``.
        seed: of initial weights, starts, targets, noise and batches.
        evaluations: number of evaluations of the actor alone.
        device, threads: of torch. The bits of a result depend on both.
    """

    name: str
    plant: str
    forward: str
    schema: Literal[1] = 1
    seed: int = 0
    evaluations: int = 50
    device: str = "cpu"
    threads: int = 1
    setting: Setting = field(default_factory=Setting)
    exploration: Exploration = field(default_factory=Exploration)
    networks: Networks = field(default_factory=Networks)
    learning: Learning = field(default_factory=Learning)

    @property
    def total_steps(self) -> int:
        """Steps of all copies together."""
        return -(-self.learning.episodes // self.setting.copies) * self.setting.task.steps

    def to_json(self) -> dict[str, Any]:
        """For lineage records; the inverse of :func:`parse_training`."""
        return asdict(self)


def load_training(path: Path) -> TrainingRecipe:
    """The recipe in ``path``; missing keys have their defaults.

    Raises:
        SettingsError: unknown keys, wrong types, impossible values.
    """
    return parse_training(read_toml(path), path)


def parse_training(values: dict[str, Any], where: object) -> TrainingRecipe:
    """``values`` as a recipe, checked; ``where`` names their source in messages."""
    recipe = parse_settings(values, TrainingRecipe, where)
    check_name(recipe.name, f"{where}: name")
    learning, exploration, networks = recipe.learning, recipe.exploration, recipe.networks
    for key, found, low, high in (
        ("seed", recipe.seed, 0, None),
        ("evaluations", recipe.evaluations, 1, None),
        ("threads", recipe.threads, 1, None),
        ("setting.copies", recipe.setting.copies, 1, None),
        ("setting.repeat", recipe.setting.repeat, 1, None),
        ("setting.curriculum", recipe.setting.curriculum, 0, 1),
        ("setting.spread", recipe.setting.spread, 0, 1),
        ("setting.start_swing", recipe.setting.start_swing, 0, 1),
        ("exploration.candidates", exploration.candidates, 1, None),
        ("exploration.sigma", exploration.sigma, 0, None),
        ("exploration.sigma_end", exploration.sigma_end, 0, exploration.sigma),
        ("exploration.theta", exploration.theta, 0, None),
        ("exploration.random_steps", exploration.random_steps, 0, None),
        ("learning.episodes", learning.episodes, 1, None),
        ("learning.updates", learning.updates, 1, None),
        ("learning.every", learning.every, 1, None),
        ("learning.batch", learning.batch, 1, learning.buffer),
        ("learning.start", learning.start, 1, learning.buffer),
        ("learning.buffer", learning.buffer, recipe.setting.copies, None),
        ("learning.discount", learning.discount, 0, 1),
        ("learning.tau", learning.tau, 0, 1),
        ("learning.hindsight", learning.hindsight, 0, 1),
        ("learning.hindsight_near", learning.hindsight_near, 0, None),
    ):
        if found is not None and not (low <= found and (high is None or found <= high)):
            raise SettingsError(f"{where}: {key}", f"{found:g}", f"{low:g} or more" if high is None else f"{low:g} to {high:g}")
    if recipe.setting.feedback == "plant" and not recipe.setting.full:
        remedy = "Set setting.full, or feedback = 'static'."
        raise SettingsError(f"{where}: setting.feedback", "'plant' without full", "the full path", remedy)
    if recipe.setting.repeat > 1 and not recipe.setting.full:
        alone = f"{recipe.setting.repeat} where joints follow at once"
        raise SettingsError(f"{where}: setting.repeat", alone, "the full path", "Set setting.full, or repeat = 1.")
    _check_task(recipe, where)
    for key, found in (
        ("learning.actor_rate", learning.actor_rate),
        ("learning.critic_rate", learning.critic_rate),
        ("exploration.time_step", exploration.time_step),
        *((f"networks.{part}", min(getattr(networks, part), default=0)) for part in ("actor", "critic")),
    ):
        if not found > 0:
            raise SettingsError(f"{where}: {key}", f"{found:g}", "above zero")
    if exploration.sigma_end is not None and not exploration.sigma_end > 0:
        raise SettingsError(f"{where}: exploration.sigma_end", f"{exploration.sigma_end:g}", "above zero")
    return recipe


def _check_task(recipe: TrainingRecipe, where: object) -> None:
    """Refuse settings of the task that exclude each other."""
    setting, residual = recipe.setting, recipe.setting.residual
    if residual is not None:
        if not setting.full:
            raise SettingsError(
                f"{where}: setting.residual", "where joints follow at once", "the full path", "Set setting.full."
            )
        if recipe.exploration.candidates > 1 and setting.feedback != "plant":
            found = f"{recipe.exploration.candidates} candidates with feedback = 'static'"
            raise SettingsError(
                f"{where}: setting.residual", found, "feedback = 'plant': a forward model does not know the tool"
            )
        for key, value in (("share", residual.share), ("full_swing", residual.full_swing)):
            if not 0.0 < value <= 1.0:
                raise SettingsError(f"{where}: setting.residual.{key}", f"{value:g}", "above 0, to 1")
    if setting.start_swing > 0.0 and not setting.full:
        raise SettingsError(
            f"{where}: setting.start_swing", "where nothing hangs at the tip", "the full path", "Set setting.full."
        )
    if setting.task.saturation > 0.0:
        if not setting.full:
            raise SettingsError(f"{where}: setting.task.saturation", "where joints follow at once", "the full path")
        if recipe.learning.hindsight > 0.0:
            found = "with hindsight, which recomputes the distance without it"
            raise SettingsError(f"{where}: setting.task.saturation", found, "learning.hindsight = 0")
