"""A deployment: the versions that control a machine, and the runner that they are assembled to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sysid.registry import CHAMPION, Registry, ancestors
from sysid_rl.run.assemble import Assembly, assemble
from sysid_rl.run.recipe import KINEMATIC, parse_runner

#: Disabled checks of the supervisor, with their reasons.
WITHOUT = {
    "domain": "the forward model is the kinematics of the plant, not a network",
    "delay": "the machine's dead time is unknown, and a simulated machine cannot be damaged",
    "motion": "the plant of a first run has no dead-bands, and a simulated machine cannot be damaged",
    "first_move": "the plant of a first run has no dead-bands, and a simulated machine cannot be damaged",
}
#: Thresholds that a machine passes with the plant of its first run, whose errors the gap workflow needs.
WIDE = {"path": {"distance": 0.1}, "frozen": {"seconds": 0.1}}
#: Rest before a run, in which the motion capture sees the parked machine [s].
REST_S = 3.0


@dataclass(frozen=True)
class Deployment:
    """Versions of the registry; ``policy`` is one of them, or inverse kinematics.

    Args:
        without: disabled checks of the supervisor, with their reasons.
        checks: changed thresholds, as in ``[checks]`` of a runner recipe.
        lookahead: of the targets [s]; None: the runner's default, none for a policy.
    """

    plant: str
    forward: str
    policy: str = "ik-lookahead"
    without: Mapping[str, str] = field(default_factory=lambda: WITHOUT)
    checks: Mapping[str, Any] = field(default_factory=lambda: WIDE)
    lookahead: float | None = None

    def assembled(self, registry: Registry, site: Path, task: Mapping[str, Any]) -> Assembly:
        """The runner for a task.

        Args:
            site: folder with the ``machine.toml`` of the owner.
            task: ``mode`` and its table, as in a runner recipe.
        """
        versions = {"plant": self.plant, "forward": self.forward, "policy": self.policy}
        models = [reference for reference in versions.values() if reference not in KINEMATIC]
        ahead = {} if self.lookahead is None else {"lookahead": self.lookahead}
        values = {
            "schema": 1,
            "name": "loop",
            "machine": str((site / "machine.toml").resolve()),
            "versions": {**versions, **ahead, "unpromoted": _unpromoted(registry, models)},
            "transport": {"kind": "can"},
            "checks": {**self.checks, "without": dict(self.without)},
            "loop": {"settle_s": REST_S, "priority": 0, "lock_memory": False},
            **task,
        }
        return assemble(parse_runner(values, "deployment"), registry, site / "runner.toml")


def _unpromoted(registry: Registry, references: list[str]) -> list[str]:
    """Versions of the run that are not promoted: those named, and the network of the plant's linkages."""
    versions = [registry.find(reference) for reference in references]
    networks = [each for each in ancestors(registry.list(), versions[0]) if each.kind in ("actuator", "history")]
    if networks:
        versions.append(max(networks, key=lambda version: version.created_ms))
    return [version.reference for version in versions if CHAMPION not in version.aliases]
