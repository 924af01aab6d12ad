"""``RUNNER.toml``: machine, versions, mode, limits and checks of a run. Unknown keys are errors."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from sysid.config import Strict, parse_settings, read_toml
from sysid.errors import SettingsError, nearest
from sysid_rl.run.checks.settings import CheckSettings, check_checks
from sysid_rl.run.limits import LimitSettings
from sysid_rl.run.modes.commission import CommissionSettings

ModeName = Literal["track", "hold", "collect", "experiment", "replay", "shadow", "teleop", "commission"]
MODES: tuple[ModeName, ...] = get_args(ModeName)
#: In place of a policy: bounded inverse kinematics, and the same with targets ahead by the machine's dead time.
KINEMATIC = ("ik", "ik-lookahead")


@dataclass(frozen=True)
class Versions(Strict):
    """``[versions]``: ``name``, ``name@3`` or ``name@champion``.

    Args:
        plant: linkages and effects for the controller.
        forward: joints → end effector.
        policy: ``ik``, ``ik-lookahead``, or a policy.
        lookahead: of the targets [s]; None: the dead time for ``ik-lookahead``, zero for others.
        unpromoted: versions without promotion that a machine may run, each as ``name@3``; the simulation in process runs all.
    """

    plant: str
    forward: str
    policy: str = "ik-lookahead"
    lookahead: float | None = None
    unpromoted: tuple[str, ...] = ()


@dataclass(frozen=True)
class TrackSettings(Strict):
    """``[track]``.

    Args:
        path: ``helix``, ``circle``, or a CSV file (t, x, y, z) beside the recipe.
        centre: of helix or circle [m]; by default where the joints keep farthest from their limits.
        laps: number of rounds.
        ease_s: duration of the speed ramps at beginning and end.
        settle_s: time for which the machine rests at the beginning of the path, e.g. until a hanging tool does.
        shaper: of the setpoints, so that a hanging tool does not swing; by the plant's ``gripper_sway``.
        live_port: follow targets from datagrams to this loopback port instead.
        live_speed, live_s: greatest speed of such a target [m/s], and duration [s].
    """

    path: str = "helix"
    centre: tuple[float, float, float] | None = None
    laps: int = 1
    ease_s: float = 1.0
    settle_s: float = 0.5
    shaper: Literal["none", "zv", "zvd"] = "none"
    live_port: int | None = None
    live_speed: float = 0.1
    live_s: float | None = None


@dataclass(frozen=True)
class HoldSettings(Strict):
    """``[hold]``: ``seconds``; None: until the operator stops."""

    seconds: float | None = 10.0


@dataclass(frozen=True)
class CollectSettings(Strict):
    """``[collect]``: number of random configurations, times at each of them, seed of the draw."""

    poses: int = 500
    settle_s: float = 1.0
    record_s: float = 0.5
    seed: int = 0


@dataclass(frozen=True)
class FileSettings(Strict):
    """``[replay]`` (CSV) and ``[experiment]`` (TOML of the gap workflow): path relative to the recipe."""

    file: str = ""


@dataclass(frozen=True)
class ShadowSettings(Strict):
    """``[shadow]``: the mode that is computed."""

    of: Literal["track", "hold", "replay", "collect"] = "track"


@dataclass(frozen=True)
class LoopSettings(Strict):
    """``[loop]``.

    Args:
        settle_s: time without violations before the machine is ready.
        ready_within_s: unattended runs end if it is not ready within this time.
        rest_s: time with neutral valves before a stop is complete; later than ``rest_within_s`` it is a fault.
        seconds: longest duration of the run; None: unlimited.
        priority: SCHED_FIFO, 1 … 99; 0: not requested.
        lock_memory: request locked memory.
        fallback: setpoints after the policy was disabled.
    """

    settle_s: float = 0.5
    ready_within_s: float = 10.0
    rest_s: float = 0.3
    rest_within_s: float = 3.0
    seconds: float | None = None
    priority: int = 50
    lock_memory: bool = True
    fallback: Literal["ik", "hold"] = "ik"


@dataclass(frozen=True)
class LogSettings(Strict):
    """``[log]``: ``folder`` for recordings, relative to the working directory."""

    folder: str = "flights"


@dataclass(frozen=True)
class RunnerRecipe(Strict):
    """The recipe; ``transport`` has a ``kind`` and the keys of that kind."""

    schema: Literal[1]
    name: str
    machine: str
    mode: ModeName
    versions: Versions
    transport: dict[str, Any]
    track: TrackSettings = field(default_factory=TrackSettings)
    hold: HoldSettings = field(default_factory=HoldSettings)
    collect: CollectSettings = field(default_factory=CollectSettings)
    experiment: FileSettings = field(default_factory=FileSettings)
    replay: FileSettings = field(default_factory=FileSettings)
    shadow: ShadowSettings = field(default_factory=ShadowSettings)
    commission: CommissionSettings = field(default_factory=CommissionSettings)
    limits: LimitSettings = field(default_factory=LimitSettings)
    checks: CheckSettings = field(default_factory=CheckSettings)
    loop: LoopSettings = field(default_factory=LoopSettings)
    log: LogSettings = field(default_factory=LogSettings)

    @property
    def in_process(self) -> bool:
        """Whether it moves a simulation in process only."""
        return bool(self.transport["kind"] == "simulated")


def load_runner(path: Path) -> RunnerRecipe:
    """The recipe in ``path``.

    Raises:
        SettingsError: unknown keys, wrong types, impossible or unsafe values.
    """
    return parse_runner(read_toml(path), path)


def parse_runner(values: dict[str, Any], where: object) -> RunnerRecipe:
    """``values`` as a recipe, checked; ``where`` names their source in messages."""
    if isinstance(values.get("mode"), str) and values["mode"] not in MODES:
        raise SettingsError(f"{where}: mode", repr(values["mode"]), nearest(values["mode"], MODES))
    recipe = parse_settings(values, RunnerRecipe, where)
    check_checks(recipe.checks, where)
    if not isinstance(recipe.transport.get("kind"), str):
        raise SettingsError(f"{where}: transport", "no kind", 'kind = "simulated", or another one')
    for key, meaning in (("valves", "one message for each axis"), ("signals", "one value of the database for each signal")):
        _check_distinct(recipe.transport.get(key), f"{where}: transport.{key}", meaning)
    loop, collect, track = recipe.loop, recipe.collect, recipe.track
    for key, found, low, high in (
        ("loop.settle_s", loop.settle_s, 0.05, 60.0),
        ("loop.ready_within_s", loop.ready_within_s, 0.1, 600.0),
        ("loop.rest_s", loop.rest_s, 0.1, 60.0),
        ("loop.rest_within_s", loop.rest_within_s, 0.2, 60.0),
        ("loop.seconds", loop.seconds, 0.1, 86400.0),
        ("loop.priority", loop.priority, 0, 99),
        ("collect.poses", collect.poses, 1, 100_000),
        ("collect.settle_s", collect.settle_s, 0.0, 60.0),
        ("collect.record_s", collect.record_s, 0.05, 60.0),
        ("track.laps", track.laps, 1, 10_000),
        ("track.ease_s", track.ease_s, 0.1, 60.0),
        ("track.live_port", track.live_port, 1024, 65535),
        ("track.live_speed", track.live_speed, 1e-4, 10.0),
        ("commission.speed", recipe.commission.speed, 0.002, 0.05),
        ("commission.travel", recipe.commission.travel, 0.002, 0.012),
        ("commission.zero", recipe.commission.zero, 0.001, 0.05),
        ("versions.lookahead", recipe.versions.lookahead, 0.0, 5.0),
    ):
        if found is not None and not low <= found <= high:
            raise SettingsError(f"{where}: {key}", f"{found:g}", f"{low:g} to {high:g}")
    for name in ("experiment", "replay"):
        wanted = recipe.mode == name or (recipe.mode == "shadow" and recipe.shadow.of == name)
        if wanted and not getattr(recipe, name).file:
            raise SettingsError(f"{where}: {name}.file", "is missing", "the file to play")
    return recipe


def _check_distinct(entries: object, where: str, expected: str) -> None:
    """Refuse two keys with one value: two axes or signals must not share a frame."""
    owners: dict[str, str] = {}
    for name, value in entries.items() if isinstance(entries, dict) else ():
        if (owner := owners.setdefault(str(value), str(name))) != name:
            raise SettingsError(f"{where}.{name}", f"{value!r}, which is that of {owner}", expected)
