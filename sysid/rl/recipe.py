"""How a policy is trained: a frozen recipe, by default that of the paper, of which a TOML file overrides single keys.

The paper gives episodes, steps, buffer, batch, γ, τ, both learning rates and σ. Number of candidates, sizes of the networks, θ
and time step of the noise are ours (``docs/ddpg.md`` lists them).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from sysid.config import STRICT, parse_settings, read_toml
from sysid.errors import SettingsError
from sysid.names import check_name
from sysid.rl.task import Task


@dataclass(frozen=True)
class Setting:
    """Where the policy acts.

    Args:
        copies: of the machine side by side; the paper has one.
        full: joint setpoints pass cylinder controllers, valves and plant; else joints follow at once, as in the paper.
        feedback: how candidates are evaluated: ``static``, by the forward model, as in the paper; ``plant``, on the full path
            alone, by where the machine will be, delay and lag included.
        repeat: samples for which an action stays while training, on the full path alone; the policy acts at every sample.
        task: steps of an episode and its rewards.
        curriculum: share of the training in which targets move away from where an episode begins, from a tenth of the way to
            anywhere within reach; 0: they are anywhere from the start, as in the paper.
    """

    __pydantic_config__ = STRICT

    copies: int = 1
    full: bool = False
    feedback: Literal["static", "plant"] = "static"
    repeat: int = 1
    task: Task = field(default_factory=Task)
    curriculum: float = 0.0


@dataclass(frozen=True)
class Exploration:
    """Which action is tried in a state.

    Args:
        candidates: actions drawn around the actor's; the one that the forward model puts nearest to the target is executed.
            One is plain DDPG, without feedback.
        sigma, theta, time_step: Ornstein–Uhlenbeck process of each candidate, of half the range of the action:
            ``x ← x − θ·x·dt + σ·√dt·n``. With dt = 1, σ is what is added at each step; Stable-Baselines3 has dt = 0.01.
        sigma_end: what σ falls to by the end, in equal ratios; None: it stays.
        random_steps: steps of each copy, at the start, whose actions are drawn from the whole range.
    """

    __pydantic_config__ = STRICT

    candidates: int = 10
    sigma: float = 0.1
    theta: float = 0.15
    time_step: float = 1.0
    sigma_end: float | None = None
    random_steps: int = 0


@dataclass(frozen=True)
class Networks:
    """Perceptrons with ReLU.

    Args:
        actor, critic: hidden layers.
        critic_head: ``value``: the last layer is Q. ``distance``: it is a point p and an offset b, and Q = b − ‖p − target‖:
            the form of the reward is built in, and where an action leads is left to learn. ``offset``: p is given from the end
            effector, for the full path, on which an action leads not far.
        critic_features: ``plain``, or ``sincos``: sine and cosine of the angles of the action beside it.
    """

    __pydantic_config__ = STRICT

    actor: tuple[int, ...] = (400, 300)
    critic: tuple[int, ...] = (400, 300)
    critic_head: Literal["value", "distance", "offset"] = "value"
    critic_features: Literal["plain", "sincos"] = "plain"


@dataclass(frozen=True)
class Learning:
    """How much is learned from what was tried.

    Args:
        episodes: of all copies together, each of ``setting.task.steps`` steps.
        updates, every: so many updates after every so many steps of all copies.
        start: transitions in the buffer before the first update.
        buffer: transitions kept.
        batch: transitions of an update.
        discount: γ. Where every setpoint can be reached within a step, γ = 0 has the same best policy as any other.
        tau: share of a network that its target takes over at each update.
        actor_rate, critic_rate: of Adam.
        schedule: ``cosine``: both rates fall to zero by the end.
        hindsight: share of a batch whose target is replaced: the reward is a function of end effector and target, so any
            target may stand in a transition. Half of them get one near where the end effector came to, as far off as the
            actor still errs, half that of another transition.
        hindsight_near: typical distance of the former [m].
    """

    __pydantic_config__ = STRICT

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
class TrainingRecipe:
    """The whole recipe.

    Args:
        name: of the policy in the registry.
        plant, forward: model versions: ``name``, ``name@3`` or ``name@champion``.
        seed: decides initial weights, starts, targets, noise and batches.
        evaluations: how often the actor alone is evaluated.
        device: of torch; ``threads``: its own, on a CPU. The bits of a result depend on both.
    """

    __pydantic_config__ = STRICT

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
    def turns(self) -> int:
        """Steps of all copies together."""
        return -(-self.learning.episodes // self.setting.copies) * self.setting.task.steps

    def to_json(self) -> dict[str, Any]:
        """For lineage records; :func:`parse_training` takes it back."""
        return asdict(self)


def load_training(path: Path) -> TrainingRecipe:
    """The recipe in ``path``; keys that it leaves out mean the paper's.

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
