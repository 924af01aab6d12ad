"""For fuzzed input: either a result, or a refusal whose message is looked at."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def attempt(refusal: type[Exception], call: Callable[[], T]) -> tuple[T | None, str]:
    """(what ``call`` returns, empty text), or (None, the message) where it raises ``refusal``; nothing else may be raised."""
    try:
        return call(), ""
    except refusal as error:
        return None, str(error) or type(error).__name__
