"""Parts of the command stage: each takes one value a step and returns one.

A part begins as if its first input had been held for a long time. ``load`` is the gravity load on the drive [N·m or N],
positive where it opposes positive motion. ``hold`` is the step of a machine that rests.
"""

from __future__ import annotations

import math
from collections import deque


def oscillation(omega: float, damping_ratio: float, dt: float) -> tuple[float, float, float, float]:
    """Free motion of ẍ + 2ζω·ẋ + ω²·x = 0 over ``dt`` [s], any ζ ≥ 0: (a, b, c, d) of x' = a·x + b·v, v' = c·x + d·v."""
    fade, square = damping_ratio * omega, omega**2 * (1.0 - damping_ratio**2)
    decay = math.exp(-fade * dt)
    if square * dt**2 > 1e-12:
        root = math.sqrt(square)
        sine, cosine = decay * math.sin(root * dt) / root, decay * math.cos(root * dt)
    elif square * dt**2 < -1e-12:
        root = math.sqrt(-square)
        slow, fast = math.exp((root - fade) * dt), math.exp(-(root + fade) * dt)
        sine, cosine = 0.5 * (slow - fast) / root, 0.5 * (slow + fast)
    else:
        sine, cosine = dt * decay, decay
    return cosine + fade * sine, sine, -(omega**2) * sine, cosine - fade * sine


class Part:
    """One effect of the command stage."""

    def reset(self) -> None:
        """Forget the past."""

    def step(self, u: float, load: float) -> float:
        """Output during a step with the input ``u``."""
        raise NotImplementedError

    def hold(self, u: float, load: float) -> float:
        """The same before the first step, with an input that was held for a long time."""
        return self.step(u, load)


class ValveHysteresis(Part):
    """y = min(max(y, u − width/2), u + width/2); width in commands."""

    def __init__(self, dt: float, width: float) -> None:
        self.half = 0.5 * width
        self.reset()

    def reset(self) -> None:
        self.y = math.nan

    def step(self, u: float, load: float) -> float:
        self.y = u if math.isnan(self.y) else min(max(self.y, u - self.half), u + self.half)
        return self.y


class ValveDeadband(Part):
    """u − positive above it, u + negative below −negative, zero between."""

    def __init__(self, dt: float, positive: float, negative: float) -> None:
        self.positive, self.negative = positive, negative

    def step(self, u: float, load: float) -> float:
        if u > self.positive:
            return u - self.positive
        return u + self.negative if u < -self.negative else 0.0


class GainCurve(Part):
    """sign(u)·|u|^exponent."""

    def __init__(self, dt: float, exponent: float) -> None:
        self.exponent = exponent

    def step(self, u: float, load: float) -> float:
        return math.copysign(abs(u) ** self.exponent, u) if u != 0.0 else u


class FlowSaturation(Part):
    """max(−limit, min(limit, u))."""

    def __init__(self, dt: float, limit: float) -> None:
        self.limit = limit

    def step(self, u: float, load: float) -> float:
        return min(max(u, -self.limit), self.limit)


class InputDelay(Part):
    """y(t) = u(t − delay), linear between samples; delay in seconds."""

    def __init__(self, dt: float, delay: float) -> None:
        self.whole = math.floor(delay / dt)
        self.rest = delay / dt - self.whole
        self.reset()

    def reset(self) -> None:
        self.past: deque[float] = deque(maxlen=self.whole + 2)

    def step(self, u: float, load: float) -> float:
        later, earlier = self.ends(u)
        return (1.0 - self.rest) * later + self.rest * earlier

    def ends(self, u: float) -> tuple[float, float]:
        """The later and the earlier of the two inputs that act in this step; the earlier one in the share ``rest`` of it."""
        if not self.past:
            self.past.extend([u] * (self.whole + 2))
        self.past.append(u)
        return self.past[-1 - self.whole], self.past[-2 - self.whole]


class CommandRateLimit(Part):
    """|dy/dt| ≤ rate [1/s, or the unit of a position per s].

    The mean over the step; ``at_end``, the held input with the same effect at the end of the step on a lag of time constant
    ``lag`` [s]: the end of the ramp where there is none.
    """

    def __init__(self, dt: float, rate: float, at_end: bool = False, lag: float = 0.0) -> None:
        self.dt, self.rate, self.reach, self.at_end, self.lag = dt, rate, rate * dt, at_end, lag
        self.reset()

    def reset(self) -> None:
        self.y = math.nan

    def step(self, u: float, load: float) -> float:
        before = u if math.isnan(self.y) else self.y
        change = min(max(u - before, -self.reach), self.reach)
        self.y = u if abs(u - before) <= self.reach else before + change
        if self.at_end:
            return self._held(before)
        if abs(u - before) > self.reach:
            return before + 0.5 * change
        return u - 0.5 * change * abs(change) / self.reach if self.reach > 0.0 else u

    def _held(self, before: float) -> float:
        if self.y == before or self.lag < 0.03 * self.dt:
            return self.y
        slope = math.copysign(self.rate, self.y - before)
        ramp = (self.y - before) / slope
        x = self.y - slope * self.lag - (before - slope * self.lag) * math.exp(-ramp / self.lag)
        x = self.y + (x - self.y) * math.exp(-(self.dt - ramp) / self.lag)
        return x / (1.0 - math.exp(-self.dt / self.lag))


class FirstOrderLag(Part):
    """T·dx/dt = u − x, exact for a held input: the mean over the step, or the value at its end; T in seconds."""

    def __init__(self, dt: float, time_constant: float, at_end: bool = False) -> None:
        self.decay = math.exp(-dt / time_constant) if time_constant >= 1e-6 else 0.0
        self.mean_decay = (1.0 - self.decay) * time_constant / dt if time_constant >= 1e-6 else 0.0
        self.at_end = at_end
        self.reset()

    def reset(self) -> None:
        self.x = math.nan

    def step(self, u: float, load: float) -> float:
        away = 0.0 if math.isnan(self.x) else self.x - u
        self.x = u + away * self.decay
        return self.x if self.at_end else u + away * self.mean_decay


class StickingSpool(Part):
    """Dead time, ramp and lag of a spool that sticks at its centre.

    It sticks while its opening is below ``release`` and the demanded one is between −``negative`` and ``positive``. ``delay``
    and ``time_constant`` in seconds, zero without; ``rate`` in 1/s, None without a ramp.
    """

    def __init__(
        self,
        dt: float,
        delay: float,
        rate: float | None,
        time_constant: float,
        positive: float,
        negative: float,
        release: float,
    ) -> None:
        self.delay, self.lag = InputDelay(dt, delay), FirstOrderLag(dt, time_constant)
        self.ramp = None if rate is None else CommandRateLimit(dt, rate)
        self.positive, self.negative, self.release = positive, negative, release

    def reset(self) -> None:
        for part in (self.delay, self.ramp, self.lag):
            if part is not None:
                part.reset()

    def step(self, u: float, load: float) -> float:
        later, earlier = self.delay.ends(u)
        if abs(self.lag.x) < self.release:
            later, earlier = self._freed(later), self._freed(earlier)
        u = (1.0 - self.delay.rest) * later + self.delay.rest * earlier
        return self.lag.step(u if self.ramp is None else self.ramp.step(u, load), load)

    def _freed(self, u: float) -> float:
        return 0.0 if -self.negative < u < self.positive else u


class GainError(Part):
    """ratio·x."""

    def __init__(self, dt: float, ratio: float) -> None:
        self.ratio = ratio

    def step(self, u: float, load: float) -> float:
        return self.ratio * u


class AsymmetricGain(Part):
    """ratio·x on the negative side, x on the positive one."""

    def __init__(self, dt: float, ratio: float) -> None:
        self.ratio = ratio

    def step(self, u: float, load: float) -> float:
        return self.ratio * u if u < 0.0 else u


class TemperatureDrift(Part):
    """x·(1 + fraction·(1 − e^(−t/T))), T in seconds, cold at the reset."""

    def __init__(self, dt: float, fraction: float, time_constant: float) -> None:
        self.fraction, self.decay = fraction, math.exp(-dt / time_constant)
        self.reset()

    def reset(self) -> None:
        self.cold = 1.0

    def step(self, u: float, load: float) -> float:
        y = self.hold(u, load)
        self.cold *= self.decay
        return y

    def hold(self, u: float, load: float) -> float:
        return u * (1.0 + self.fraction * (1.0 - self.cold))


class LoadDependentFlow(Part):
    """x·(1 − coefficient·load·sign(x)), not below zero; coefficient in 1/(N·m) or 1/N."""

    def __init__(self, dt: float, coefficient: float) -> None:
        self.coefficient = coefficient

    def step(self, u: float, load: float) -> float:
        return u * max(1.0 - self.coefficient * load * (1.0 if u > 0.0 else -1.0), 0.0)


class NominalGain(Part):
    """Command → speed: gain·x [m/s or rad/s]."""

    def __init__(self, dt: float, gain: float) -> None:
        self.gain = gain

    def step(self, u: float, load: float) -> float:
        return self.gain * u


class InternalLeakage(Part):
    """v − rate [m/s or rad/s]."""

    def __init__(self, dt: float, rate: float) -> None:
        self.rate = rate

    def step(self, u: float, load: float) -> float:
        return u - self.rate


class Stiction(Part):
    """At rest until |v| > breakaway·gain, then v until |v| < release·gain; both in commands."""

    def __init__(self, dt: float, breakaway: float, release: float, least: float, gain: float) -> None:
        self.breakaway = breakaway * gain
        self.release = min(max(release, least), breakaway) * gain
        self.reset()

    def reset(self) -> None:
        self.moves = False

    def step(self, u: float, load: float) -> float:
        self.moves = abs(u) >= self.release if self.moves else abs(u) > self.breakaway
        return u if self.moves else 0.0


class OilCompressibility(Part):
    """v̈ + 2ζω·v̇ + ω²·v = ω²·u, ω = 2π·frequency [Hz], exact for a held input; the mean over the step."""

    def __init__(self, dt: float, frequency: float, damping_ratio: float) -> None:
        self.dt, self.omega = dt, 2.0 * math.pi * frequency
        self.fade, self.matrix = damping_ratio * self.omega, oscillation(self.omega, damping_ratio, dt)
        self.reset()

    def reset(self) -> None:
        self.x, self.v = math.nan, 0.0

    def step(self, u: float, load: float) -> float:
        x, v = 0.0 if math.isnan(self.x) else self.x - u, self.v
        a, b, c, d = self.matrix
        after, slope = a * x + b * v, c * x + d * v
        self.x, self.v = u + after, slope
        return u - ((slope - v) + 2.0 * self.fade * (after - x)) / (self.omega**2 * self.dt)


class SecondOrderLag(Part):
    """T²·ẍ + 2ζT·ẋ + x = u, exact for a held input: the value at the end of the step; T in seconds.

    The load follows through the same loop (``sag_load``), since the sag of a servo is an error of its loop.
    """

    def __init__(self, dt: float, time_constant: float, damping_ratio: float) -> None:
        self.matrix = oscillation(1.0 / time_constant, damping_ratio, dt)
        self.reset()

    def reset(self) -> None:
        self.state, self.load = (math.nan, 0.0), (math.nan, 0.0)

    def step(self, u: float, load: float) -> float:
        self.load = self._advance(load, self.load)
        self.state = self._advance(u, self.state)
        return self.state[0]

    def sag_load(self, load: float) -> float:
        """The load under which the servo sags; ``load`` itself before the first step."""
        return load if math.isnan(self.load[0]) else self.load[0]

    def _advance(self, u: float, state: tuple[float, float]) -> tuple[float, float]:
        if math.isnan(state[0]):
            return u, 0.0
        a, b, c, d = self.matrix
        x, v = state[0] - u, state[1]
        return u + a * x + b * v, c * x + d * v
