"""How many examples a property is tried on: an eighth in ``make test``, all of them in ``make test-slow``."""

from __future__ import annotations

import os


def examples(number: int) -> int:
    """``number`` where new examples are drawn (``HYPOTHESIS_PROFILE=explore``), else an eighth of them, five at least."""
    return number if os.environ.get("HYPOTHESIS_PROFILE") == "explore" else max(5, number // 8)
