"""Whether a version becomes what its name alone means, and the record of that: one way for networks and plants.

What was asked of a version are :class:`Check` values; who asks differs: :mod:`sysid.gap.promotion` questions plants,
:mod:`sysid.versions.policy` networks. Every decision stays with the version, the refused ones too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sysid.errors import StorageError, StoreError
from sysid.registry.decision import Check, Promotion, PromotionDecision, now_ms
from sysid.registry.registry import Registry
from sysid.registry.version import ModelVersion


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
        evaluated: what evaluated it, for the record.
        word: promotes it whatever the checks say; recorded.

    Raises:
        StorageError: the disk is full, or may not be written.
    """
    previous = until_now.reference if until_now is not None else ""
    reason = "; ".join(check.text for check in checks if check.status == "failed")
    promoted = bool(word) or not reason
    decision = PromotionDecision(promoted, previous, tuple(checks), reason, word, dict(judged or {}), now_ms())
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
