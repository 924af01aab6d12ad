"""Conditions of a promotion and the decision, which are stored with the version."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Literal

from pydantic import TypeAdapter

from sysid.display import minute
from sysid.errors import StoreError
from sysid.parse import parse_json


@dataclass(frozen=True)
class Check:
    """One condition of a promotion: its name, whether it holds, and the figures as text."""

    name: str
    status: Literal["passed", "failed", "left out"]
    text: str


@dataclass(frozen=True)
class Promotion:
    """Result of a promotion.

    Args:
        version: the evaluated version, ``name@version``.
        current: the champion now.
        previous: the champion before; empty if there was none.
        checks: the conditions.
        reason: why it was not promoted; empty if it was.
    """

    version: str
    current: str
    previous: str
    checks: tuple[Check, ...]
    reason: str = ""

    @property
    def promoted(self) -> bool:
        return not self.reason


@dataclass(frozen=True)
class PromotionDecision:
    """A decision on the promotion of a version, stored with it.

    Args:
        promoted: whether it became the champion.
        instead_of: the champion before; empty if there was none.
        checks: the conditions.
        reason: why it was not promoted, or what failed and was overruled.
        word: the user's reason to promote it regardless of the checks; empty if the checks decided.
        judged: basis of the decision as plain JSON: the policy, the dataset version.
        decided_ms: time, milliseconds since 1970.
    """

    promoted: bool
    instead_of: str
    checks: tuple[Check, ...]
    reason: str = ""
    word: str = ""
    judged: Mapping[str, Any] = field(default_factory=dict)
    decided_ms: int = 0

    def same(self, other: PromotionDecision) -> bool:
        """Whether both are equal except for their time."""
        return replace(self, decided_ms=0) == replace(other, decided_ms=0)

    def to_text(self) -> str:
        return json.dumps(asdict(self), ensure_ascii=False, sort_keys=True, separators=(",", ":"))

    @staticmethod
    def from_text(text: str, where: object) -> PromotionDecision:
        """The inverse of :meth:`to_text`.

        Raises:
            StoreError: not a decision.
        """
        try:
            values = parse_json(text)
            if unknown := set(values) - {entry.name for entry in fields(PromotionDecision)}:
                raise ValueError(f"unknown key {min(unknown)!r}")
            return _DECISION.validate_python(values)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            found = f"not a decision ({type(error).__name__}: {error})"
            raise StoreError(where, found, "what sysid recorded", "Remove that tag in the registry.") from None


_DECISION = TypeAdapter(PromotionDecision)


def now_ms() -> int:
    """Milliseconds since 1970."""
    return time.time_ns() // 1_000_000


def decision_row(decision: PromotionDecision) -> tuple[str, str, str, str]:
    """Time, decision, what decided it, and reason, as text."""
    when = minute(decision.decided_ms)
    instead = f" instead of {decision.instead_of}" if decision.promoted and decision.instead_of else ""
    what = f"promoted{instead}" if decision.promoted else f"not promoted, {decision.instead_of or 'none'} stays"
    evaluated_by = str(decision.judged.get("policy") or decision.judged.get("by") or "–")
    evaluated_by = f"policy {evaluated_by}" if decision.judged.get("by") == "policy" else evaluated_by
    if decision.word:
        overruled = f" (overruled: {decision.reason})" if decision.reason else ""
        return when, what, "user", f"{decision.word}{overruled}"
    passed = sum(check.status == "passed" for check in decision.checks)
    result = f"all {passed} conditions hold" if passed else "; ".join(check.text for check in decision.checks)
    return when, what, evaluated_by, decision.reason or str(decision.judged.get("as", "")) or result
