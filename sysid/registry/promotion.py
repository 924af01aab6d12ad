"""Whether a version becomes what its name alone means, and the record of that: one way for networks and plants.

What was asked of a version are :class:`Check` values; who asks differs: :mod:`sysid.gap.promotion` questions plants,
:mod:`sysid.versions.policy` networks. Every decision stays with the version, the refused ones too.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Literal

from pydantic import TypeAdapter

from sysid.errors import StorageError, StoreError
from sysid.parse import parse_json

if TYPE_CHECKING:
    from sysid.registry.registry import Registry
    from sysid.registry.version import ModelVersion


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
        version: that was judged, ``name@version``.
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
class Decision:
    """What was decided about a version, kept with it.

    Args:
        promoted: whether it became what the name alone means.
        instead_of: what it took the place of, or would have; empty where nothing had been promoted.
        checks: what was asked of it.
        reason: why it was not promoted, or what failed and was overruled.
        word: somebody's reason to promote it whatever the checks say; empty where the checks decided.
        judged: what judged it, as plain JSON: the policy, the dataset version.
        decided_ms: when, milliseconds since 1970.
    """

    promoted: bool
    instead_of: str
    checks: tuple[Check, ...]
    reason: str = ""
    word: str = ""
    judged: Mapping[str, Any] = field(default_factory=dict)
    decided_ms: int = 0

    def same(self, other: Decision) -> bool:
        """Whether both are equal but for their time."""
        return replace(self, decided_ms=0) == replace(other, decided_ms=0)

    def to_json(self) -> dict[str, Any]:
        return asdict(self)

    def to_text(self) -> str:
        return json.dumps(self.to_json(), ensure_ascii=False, sort_keys=True, separators=(",", ":"))

    @staticmethod
    def from_text(text: str, where: object) -> Decision:
        """What :meth:`to_text` wrote.

        Raises:
            StoreError: it is something else.
        """
        try:
            values = parse_json(text)
            if unknown := set(values) - {entry.name for entry in fields(Decision)}:
                raise ValueError(f"unknown key {min(unknown)!r}")
            return _DECISION.validate_python(values)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            found = f"not a decision ({type(error).__name__}: {error})"
            raise StoreError(where, found, "what sysid recorded", "Remove that tag in the registry.") from None


_DECISION = TypeAdapter(Decision)


def now_ms() -> int:
    """Milliseconds since 1970."""
    return time.time_ns() // 1_000_000


def decide(
    registry: Registry,
    version: str,
    until_now: ModelVersion | None,
    checks: Sequence[Check],
    judged: Mapping[str, Any] | None = None,
    word: str = "",
) -> Promotion:
    """Promote a stored version if all checks pass, say why not otherwise, and record either with it.

    Args:
        version: ``name@version``.
        until_now: what was promoted when the checks were made.
        judged: what judged it, for the record.
        word: promotes it whatever the checks say; recorded.

    Raises:
        StorageError: the disk is full, or may not be written.
    """
    previous = until_now.reference if until_now is not None else ""
    reason = "; ".join(check.text for check in checks if check.status == "failed")
    promoted = bool(word) or not reason
    decision = Decision(promoted, previous, tuple(checks), reason, word, dict(judged or {}), now_ms())
    if not promoted:
        registry.record(version, decision)
        return Promotion(version, previous, previous, tuple(checks), reason)
    if version != previous:
        try:
            registry.promote(version, instead_of=until_now, decision=decision)
        except StorageError:
            raise
        except StoreError as error:  # the version is stored, and the next time it may be promoted
            now = registry.promoted(version.partition("@")[0])
            return Promotion(version, now.reference if now else "", previous, tuple(checks), str(error))
    return Promotion(version, version, previous, tuple(checks))
