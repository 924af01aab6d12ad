"""Result of the gap workflow over a fleet, as frozen values and as JSON (``docs/guide/fleet.md``)."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

from sysid.config import Strict
from sysid.fleet.differences import Difference
from sysid.fleet.drift import Drift
from sysid.fleet.effects import FleetEffect, ParameterHistory
from sysid.gap.statement import Verdict

#: Conditions under which a scheduled run fails.
Condition = Literal["differs", "drift", "any"]


@dataclass(frozen=True)
class FleetMachine(Strict):
    """One machine: its dataset version and what the gap workflow says of it alone.

    Args:
        effects: those that it names.
    """

    dataset: str
    verdict: Verdict
    effects: tuple[FleetEffect, ...]

    @property
    def name(self) -> str:
        """The name of the dataset, without its version."""
        return self.dataset.partition("@")[0]


@dataclass(frozen=True)
class FleetResult:
    """Result of :func:`sysid.fleet.fleet_gap`.

    Args:
        effects: named on at least one machine.
        histories: their values in every recording.
        differences: one for each parameter; ``drifts``: parameters that changed.
        false_alarms_per_1000_hours: accepted for each machine.
    """

    machines: tuple[FleetMachine, ...]
    effects: tuple[FleetEffect, ...]
    histories: tuple[ParameterHistory, ...]
    differences: tuple[Difference, ...]
    drifts: tuple[Drift, ...]
    false_alarms_per_1000_hours: float
    seconds: float

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader of the names has to know."""
        drifting = dict.fromkeys(drift.machine for drift in self.drifts)
        return tuple(
            f"{name}: its effects are named from recordings before and after a change; one that is named there alone may only "
            "describe the change. Ingest the recordings after it as a dataset of their own."
            for name in drifting
        )

    def named_on(self, effect: FleetEffect) -> tuple[str, ...]:
        """Machines on which the workflow names an effect, in any of its forms."""
        return tuple(m.name for m in self.machines if any(own.key == effect.key for own in m.effects))

    def fulfils(self, condition: Condition) -> bool:
        """Whether a scheduled run with this condition fails."""
        differs, drifts = any(item.differs for item in self.differences), bool(self.drifts)
        return {"differs": differs, "drift": drifts, "any": differs or drifts}[condition]

    def to_json(self) -> dict[str, Any]:
        return {
            "schema": 1,
            **asdict(self),
            "effects": [{**asdict(effect), "named_on": list(self.named_on(effect))} for effect in self.effects],
            "notes": list(self.notes),
        }
