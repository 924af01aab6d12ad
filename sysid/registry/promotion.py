"""Decides on the promotion of a version by its :class:`Check` values, and records the decision with it.

The checks of plants are made in :mod:`sysid.gap.promotion`, those of networks in :mod:`sysid.versions.policy`.
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
    champion: ModelVersion | None,
    checks: Sequence[Check],
    judged: Mapping[str, Any] | None = None,
    word: str = "",
) -> Promotion:
    """Promote a stored version if all checks pass, and record the decision with it.

    Args:
        version: ``name@version``.
        champion: the champion when the checks were made.
        judged: basis of the decision, for the record.
        word: the user's reason to promote it regardless of the checks; recorded.

    Raises:
        StorageError: the disk is full or read-only.
    """
    previous = champion.reference if champion is not None else ""
    reason = "; ".join(check.text for check in checks if check.status == "failed")
    promoted = bool(word) or not reason
    decision = PromotionDecision(promoted, previous, tuple(checks), reason, word, dict(judged or {}), now_ms())
    if not promoted:
        registry.record(version, decision)
        return Promotion(version, previous, previous, tuple(checks), reason)
    if version != previous:
        try:
            registry.promote(version, instead_of=champion, decision=decision)
        except StorageError:
            raise
        except StoreError as error:  # another champion was set in the meantime
            now = registry.promoted(version.partition("@")[0])
            return Promotion(version, now.reference if now else "", previous, tuple(checks), str(error))
    return Promotion(version, version, previous, tuple(checks))
