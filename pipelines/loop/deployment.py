"""A deployment: the versions that control a machine, and the runner that they are assembled to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sysid.registry import CHAMPION, Registry, ancestors
from sysid_rl.run.assemble import Assembly, assemble
from sysid_rl.run.recipe import KINEMATIC, parse_runner

#: Thresholds of every deployment: the play of an identified plant is not exact.
USUAL = {"frozen": {"seconds": 0.1}}
#: Thresholds that a machine passes with a plant that was never identified, whose errors the gap workflow needs.
WIDE = {**USUAL, "path": {"distance": 0.1}, "motion": {"wider": 0.4}, "delay": {"after_s": 0.2}}
#: Rest before a run, in which the motion capture sees the parked machine [s].
REST_S = 3.0


@dataclass(frozen=True)
class Deployment:
    """Versions of the registry; ``policy`` is one of them, or inverse kinematics.

    Args:
        checks: changed thresholds, as in ``[checks]`` of a runner recipe; those of a plant that was identified are the default.
        shaper: of the setpoints on a path, against the swing of the tool.
        lookahead: of the targets [s]; None: the runner's default, none for a policy.
    """

    plant: str
    forward: str
    policy: str = "ik-lookahead"
    checks: Mapping[str, Any] = field(default_factory=lambda: USUAL)
    lookahead: float | None = None
    shaper: str = "none"

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
            "checks": dict(self.checks),
            "loop": {"settle_s": REST_S, "priority": 0, "lock_memory": False},
            **task,
            **({"track": {**task["track"], "shaper": self.shaper}} if "track" in task else {}),
        }
        return assemble(parse_runner(values, "deployment"), registry, site / "runner.toml")


def _unpromoted(registry: Registry, references: list[str]) -> list[str]:
    """Versions of the run that are not promoted: those named, and the network of the plant's linkages."""
    versions = [registry.find(reference) for reference in references]
    networks = [each for each in ancestors(registry.list(), versions[0]) if each.kind in ("actuator", "history")]
    if networks:
        versions.append(max(networks, key=lambda version: version.created_ms))
    return [version.reference for version in versions if CHAMPION not in version.aliases]
