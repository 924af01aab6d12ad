"""The unit of stamps without one, from the rate and the date that each unit gives."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

#: Unit → seconds.
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "day": 86400.0}
#: Rates of logs of machines [Hz]. A unit with more than :data:`FAST` is left out where another gives at least :data:`SLOW`:
#: a joystick at 19 Hz is common, one at 19 kHz is not.
RATES, SLOW, FAST = (1.0, 20e3), 5.0, 5e3
#: Longest log [s].
LONGEST_S = 30 * 86400.0
#: The machine's rate decides between units where one gives a rate within this factor.
NEAR = 10.0
#: Steps that show a rate: two events do not.
FEWEST = 5
#: Stamps that are used.
_STAMPS = 2**16
#: Unix time from 2000 to 2100 [s].
_UNIX = (946_684_800.0, 4_102_444_800.0)
#: Counts of days: 1970-01-01 in each, and its name.
_CALENDARS = ((25_569.0, "days of a spreadsheet (since 1899-12-30)"), (719_529.0, "days of MATLAB's datenum (since year 0)"))
_NAMES = (
    ("us", r"(^|[^a-z])(us|µs|usec|micros|microseconds)$|(?-i:[a-z]US$)"),
    ("ms", r"(^|[^a-z])(ms|msec|millis|milliseconds)$|(?-i:[a-z]MS$)"),
    ("ns", r"(^|[^a-z])(ns|nsec|nanos|nanosec|nanoseconds)$|(?-i:[a-z]NS$)"),
    ("day", r"(^|[^a-z])(days?)$"),
    ("s", r"(^|[^a-z])(s|secs?|seconds)$"),
)


@dataclass(frozen=True)
class TimeUnit:
    """A unit with the rate [Hz] and the length of the log [s] that it gives."""

    unit: str
    rate_hz: float
    seconds: float

    def __str__(self) -> str:
        return f"{self.unit} ({self.rate_hz:.4g} Hz, {self.seconds:.4g} s)"


def as_unit(values: npt.NDArray[np.float64], unit: str) -> TimeUnit | None:
    """``values`` (n,) read in ``unit``; None where fewer than :data:`FEWEST` steps show the rate."""
    seen = values[:_STAMPS]
    seen = seen[np.isfinite(seen)]
    steps = np.diff(seen)
    steps = steps[steps > 0.0]
    if len(steps) < FEWEST:
        return None
    factor = SECONDS[unit]
    ends = values[[0, -1]]
    span = float(abs(ends[1] - ends[0])) if np.isfinite(ends).all() else float(seen.max() - seen.min())
    return TimeUnit(unit, 1.0 / (float(np.median(steps)) * factor), span * factor)


def likely_units(values: npt.NDArray[np.float64], name: str = "", expected_hz: float | None = None) -> tuple[TimeUnit, ...]:
    """Units that give stamps (n,) a plausible rate, the likeliest first; more than one where nothing decides between them.

    A unit in the column's ``name`` decides, else dates from 2000 to 2100, else the machine's rate ``expected_hz`` [Hz].
    """
    found = [unit for name_ in SECONDS if (unit := as_unit(values, name_)) is not None]
    found = [u for u in found if RATES[0] <= u.rate_hz * (1 + 1e-6) and u.rate_hz <= RATES[1] and u.seconds <= LONGEST_S]
    if not found:
        return ()
    named = unit_in_name(name)
    size = float(np.nanmedian(np.abs(values[:_STAMPS])))
    dated = {unit for unit, seconds in SECONDS.items() if unit != "day" and _UNIX[0] <= size * seconds <= _UNIX[1]}
    dated |= {"day"} if days_origin(np.array([size]))[1] else set()
    for decisive in ({named}, dated):
        if chosen := [unit for unit in found if unit.unit in decisive]:
            return tuple(chosen)
    found = [unit for unit in found if unit.unit != "day"]
    if any(SLOW <= unit.rate_hz <= FAST for unit in found):
        slow = any(SLOW <= unit.rate_hz <= 1e-3 * RATES[1] for unit in found)
        found = [unit for unit in found if unit.rate_hz <= FAST or not slow]
    if expected_hz is not None:
        near = [unit for unit in found if 1.0 / NEAR <= unit.rate_hz / expected_hz <= NEAR]
        found = near or found
    return tuple(found)


def days_origin(values: npt.NDArray[Any]) -> tuple[float, str]:
    """1970-01-01 in the count of days that gives all ``values`` (n,) a date from 2000 to 2100, and its name; else (0, "")."""
    for origin, name in _CALENDARS:
        first, last = (origin + seconds / SECONDS["day"] for seconds in _UNIX)
        if len(values) and np.all((first <= values) & (values <= last)):
            return origin, name
    return 0.0, ""


def unit_in_name(name: str) -> str | None:
    """The unit of time in the name of a column: ``t_us``, ``TimeUS``, ``time (ms)``."""
    text = name.strip().rstrip(")]").strip()
    return next((unit for unit, pattern in _NAMES if re.search(pattern, text, re.IGNORECASE)), None)
