"""What was asked of a model version, and what was decided: values that stay with the version."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Literal

from pydantic import TypeAdapter

from sysid.errors import StoreError
from sysid.parse import parse_json


@dataclass(frozen=True)
class Check:
    """One condition of a promotion: what was looked at, whether it holds, and the figures in words."""

    name: str
    status: Literal["passed", "failed", "left out"]
    text: str


@dataclass(frozen=True)
class Promotion:
    """Whether a stored version became what its name alone means.

    Args:
        version: that was evaluated, ``name@version``.
        current: what the name alone means now.
        previous: what it meant before; empty where nothing had been promoted.
        checks: what was asked of it.
        reason: why it was not promoted; empty where it was.
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
    """What was decided about a version, kept with it.

    Args:
        promoted: whether it became what the name alone means.
        instead_of: what it took the place of, or would have; empty where nothing had been promoted.
        checks: what was asked of it.
        reason: why it was not promoted, or what failed and was overruled.
        word: somebody's reason to promote it whatever the checks say; empty where the checks decided.
        evaluated: what evaluated it, as plain JSON: the policy, the dataset version.
        decided_ms: when, milliseconds since 1970.
    """

    promoted: bool
    instead_of: str
    checks: tuple[Check, ...]
    reason: str = ""
    word: str = ""
    judged: Mapping[str, Any] = field(default_factory=dict)
    decided_ms: int = 0

    def same(self, other: PromotionDecision) -> bool:
        """Whether both are equal but for their time."""
        return replace(self, decided_ms=0) == replace(other, decided_ms=0)

    def to_json(self) -> dict[str, Any]:
        return asdict(self)

    def to_text(self) -> str:
        return json.dumps(self.to_json(), ensure_ascii=False, sort_keys=True, separators=(",", ":"))

    @staticmethod
    def from_text(text: str, where: object) -> PromotionDecision:
        """What :meth:`to_text` wrote.

        Raises:
            StoreError: it is something else.
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
