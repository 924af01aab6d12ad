"""Parts of the command stage, each ``(u, load, state, theta, hold)`` → ``(output, state)``; ``hold``: the machine rests.

``at`` is the column of the first parameter of a part in ``theta``; the others follow in the order of its docstring.
"""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor, nn


def parameter(theta: Tensor, at: int, absent: float) -> Tensor:
    """Column ``at`` of the parameters (N, P), or ``absent`` where ``at`` is negative, (N,)."""
    if at < 0:
        return torch.full_like(theta[:, 0], absent)
    return theta[:, at]


def damped_sine(fade: Tensor, square: Tensor, dt: float) -> tuple[Tensor, Tensor]:
    """e^(−fade·dt)·sin(r·dt)/r and e^(−fade·dt)·cos(r·dt) with r² = ``square``, also for r² ≤ 0, (N,) each."""
    decay = torch.exp(-fade * dt)
    turns, creeps = square * dt**2 > 1e-12, square * dt**2 < -1e-12
    root = torch.sqrt(torch.where(turns | creeps, torch.abs(square), torch.ones_like(square)))
    slow, fast = torch.exp((root - fade) * dt), torch.exp(-(root + fade) * dt)
    sine = torch.where(turns, decay * torch.sin(root * dt) / root, torch.where(creeps, 0.5 * (slow - fast) / root, dt * decay))
    cosine = torch.where(turns, decay * torch.cos(root * dt), torch.where(creeps, 0.5 * (slow + fast), decay))
    return sine, cosine


def free_motion(omega: Tensor, fade: Tensor, sine: Tensor, cosine: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The transition of place and speed over that step: (a, b, c, d), x' = a·x + b·v, v' = c·x + d·v."""
    return cosine + fade * sine, sine, -(omega**2) * sine, cosine - fade * sine


Step = tuple[Tensor, Tensor]


class Part(nn.Module):
    """One effect; ``width``: numbers that it remembers."""

    def __init__(self, dt: float, at: int, width: int = 0) -> None:
        super().__init__()
        self.dt, self.at, self.width = dt, at, width


class ValveHysteresis(Part):
    """width"""

    def __init__(self, dt: float, at: int) -> None:
        super().__init__(dt, at, 1)

    def forward(self, u: Tensor, load: Tensor, state: Tensor, theta: Tensor, hold: bool) -> Step:
        half = 0.5 * theta[:, self.at]
        y = torch.where(torch.isnan(state[:, 0]), u, torch.minimum(torch.maximum(state[:, 0], u - half), u + half))
        return y, y[:, None]


class ValveDeadband(Part):
    """positive, negative"""

    def forward(self, u: Tensor, load: Tensor, state: Tensor, theta: Tensor, hold: bool) -> Step:
        return torch.relu(u - theta[:, self.at]) - torch.relu(-u - theta[:, self.at + 1]), state


class GainCurve(Part):
    """exponent"""

    def forward(self, u: Tensor, load: Tensor, state: Tensor, theta: Tensor, hold: bool) -> Step:
        return torch.sign(u) * torch.abs(u) ** theta[:, self.at], state


class FlowSaturation(Part):
    """limit"""

    def forward(self, u: Tensor, load: Tensor, state: Tensor, theta: Tensor, hold: bool) -> Step:
        limit = theta[:, self.at]
        return torch.maximum(torch.minimum(u, limit), -limit), state


class InputDelay(Part):
    """delay; ``width``: samples that the longest delay needs, newest first"""

    def forward(self, u: Tensor, load: Tensor, state: Tensor, theta: Tensor, hold: bool) -> Step:
        recent, older, part, past = self.ends(u, state, theta)
        return (1.0 - part) * recent + part * older, past

    def ends(self, u: Tensor, state: Tensor, theta: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The two inputs that act in this step, the share of it in which the older one acts, and the state."""
        samples = torch.clamp(parameter(theta, self.at, 0.0) / self.dt, 0.0, float(self.width - 1))
        whole = torch.clamp(torch.floor(samples), max=float(self.width - 2))
        past = torch.where(torch.isnan(state), u[:, None], state)
        past = torch.cat([u[:, None], past[:, : self.width - 1]], dim=1)
        index = whole.to(torch.int64)[:, None]
        return past.gather(1, index)[:, 0], past.gather(1, index + 1)[:, 0], samples - whole, past


class CommandRateLimit(Part):
    """rate; ``at_end`` and ``lag_at`` as in the drive model: the column of the time constant behind it, −1 for none"""

    def __init__(self, dt: float, at: int, at_end: bool = False, lag_at: int = -1) -> None:
        super().__init__(dt, at, 1)
        self.at_end, self.lag_at = at_end, lag_at

    def forward(self, u: Tensor, load: Tensor, state: Tensor, theta: Tensor, hold: bool) -> Step:
        rate = parameter(theta, self.at, float("inf"))
        reach = rate * self.dt
        before = torch.where(torch.isnan(state[:, 0]), u, state[:, 0])
        change = torch.maximum(torch.minimum(u - before, reach), -reach)
        within = torch.abs(u - before) <= reach
        y = torch.where(within, u, before + change)
        if self.at_end:
            return self.held(before, y, rate, theta), y[:, None]
        mean = torch.where(reach > 0.0, u - 0.5 * change * torch.abs(change) / reach, u)
        return torch.where(within, mean, before + 0.5 * change), y[:, None]

    def held(self, before: Tensor, y: Tensor, rate: Tensor, theta: Tensor) -> Tensor:
        """The held input that moves the lag by as much as the ramp does."""
        lag = parameter(theta, self.lag_at, 0.0)
        plain = (y == before) | (lag < 0.03 * self.dt)
        lag = torch.where(plain, torch.full_like(lag, self.dt), lag)
        slope = torch.where(plain, torch.ones_like(rate), torch.copysign(rate, y - before))
        ramp = (y - before) / slope
        x = y - slope * lag - (before - slope * lag) * torch.exp(-ramp / lag)
        x = y + (x - y) * torch.exp(-(self.dt - ramp) / lag)
        return torch.where(plain, y, x / (1.0 - torch.exp(-self.dt / lag)))


class FirstOrderLag(Part):
    """time_constant"""

    def __init__(self, dt: float, at: int, at_end: bool = False) -> None:
        super().__init__(dt, at, 1)
        self.at_end = at_end

    def forward(self, u: Tensor, load: Tensor, state: Tensor, theta: Tensor, hold: bool) -> Step:
        constant = parameter(theta, self.at, 0.0)
        slow = constant >= 1e-6
        lag = torch.where(slow, constant, torch.ones_like(u))
        decay = torch.where(slow, torch.exp(-self.dt / lag), torch.zeros_like(u))
        away = torch.where(torch.isnan(state[:, 0]), torch.zeros_like(u), state[:, 0] - u)
        x = u + away * decay
        mean = torch.where(slow, u + away * (1.0 - decay) * lag / self.dt, u)
        return x if self.at_end else mean, x[:, None]


class StickingSpool(Part):
    """spool_breakaway, spool_release

    Args:
        at: column of the first of these two. overlap_at: column of the first overlap, −1 for none.
        least: the least ``spool_release``.
        edges: static parts that open with the spool.
    """

    def __init__(
        self,
        dt: float,
        at: int,
        overlap_at: int,
        least: float,
        delay: InputDelay,
        ramp: CommandRateLimit,
        lag: FirstOrderLag,
        edges: list[Part],
    ) -> None:
        super().__init__(dt, at, 2 + delay.width)
        self.overlap_at, self.least = overlap_at, least
        self.delay, self.ramp, self.lag = delay, ramp, lag
        self.edges: Any = nn.ModuleList(edges)

    def forward(self, u: Tensor, load: Tensor, state: Tensor, theta: Tensor, hold: bool) -> Step:
        later, earlier, part, past = self.delay.ends(u, state[:, 2:], theta)
        overlap = parameter(theta, self.overlap_at, 0.0)
        if self.overlap_at >= 0:
            overlap = torch.minimum(overlap, theta[:, self.overlap_at + 1])
        frees = theta[:, self.at] + overlap
        positive, negative = self.opening(frees, load, state, theta), -self.opening(-frees, load, state, theta)
        rests = torch.abs(state[:, 1]) < torch.clamp(theta[:, self.at + 1], min=self.least)
        later = torch.where(rests & (later < positive) & (later > -negative), torch.zeros_like(u), later)
        earlier = torch.where(rests & (earlier < positive) & (earlier > -negative), torch.zeros_like(u), earlier)
        u = (1.0 - part) * later + part * earlier
        u, ramp = self.ramp(u, load, state[:, :1], theta, hold)
        u, lag = self.lag(u, load, state[:, 1:2], theta, hold)
        return u, torch.cat([ramp, lag, past], dim=1)

    def opening(self, x: Tensor, load: Tensor, state: Tensor, theta: Tensor) -> Tensor:
        """Opening at a place of the spool."""
        for edge in self.edges:
            x, _ = edge(x, load, state[:, :0], theta, False)
        return x


class GainError(Part):
    """ratio"""

    def forward(self, u: Tensor, load: Tensor, state: Tensor, theta: Tensor, hold: bool) -> Step:
        return theta[:, self.at] * u, state


class AsymmetricGain(Part):
    """ratio"""

    def forward(self, u: Tensor, load: Tensor, state: Tensor, theta: Tensor, hold: bool) -> Step:
        return torch.where(u < 0.0, theta[:, self.at] * u, u), state


class TemperatureDrift(Part):
    """fraction, time_constant; remembers how cold it is"""

    def __init__(self, dt: float, at: int) -> None:
        super().__init__(dt, at, 1)

    def forward(self, u: Tensor, load: Tensor, state: Tensor, theta: Tensor, hold: bool) -> Step:
        cold = torch.where(torch.isnan(state[:, 0]), torch.ones_like(u), state[:, 0])
        y = u * (1.0 + theta[:, self.at] * (1.0 - cold))
        return y, (cold if hold else cold * torch.exp(-self.dt / theta[:, self.at + 1]))[:, None]


class LoadDependentFlow(Part):
    """coefficient"""

    def forward(self, u: Tensor, load: Tensor, state: Tensor, theta: Tensor, hold: bool) -> Step:
        sign = torch.where(u > 0.0, torch.ones_like(u), -torch.ones_like(u))
        return u * torch.relu(1.0 - theta[:, self.at] * load * sign), state


class NominalGain(Part):
    """No parameter: the gain of the machine's description."""

    def __init__(self, dt: float, gain: float) -> None:
        super().__init__(dt, 0)
        self.gain = gain

    def forward(self, u: Tensor, load: Tensor, state: Tensor, theta: Tensor, hold: bool) -> Step:
        return self.gain * u, state


class InternalLeakage(Part):
    """rate"""

    def forward(self, u: Tensor, load: Tensor, state: Tensor, theta: Tensor, hold: bool) -> Step:
        return u - theta[:, self.at], state


class Stiction(Part):
    """breakaway, release"""

    def __init__(self, dt: float, at: int, least: float, gain: float) -> None:
        super().__init__(dt, at, 1)
        self.least, self.gain = least, gain

    def forward(self, u: Tensor, load: Tensor, state: Tensor, theta: Tensor, hold: bool) -> Step:
        breakaway, release = theta[:, self.at], torch.clamp(theta[:, self.at + 1], min=self.least)
        release = torch.minimum(release, breakaway) * self.gain
        size = torch.abs(u)
        moves = torch.where(state[:, 0] > 0.5, size >= release, size > breakaway * self.gain)
        return torch.where(moves, u, torch.zeros_like(u)), moves.to(u.dtype)[:, None]


class OilCompressibility(Part):
    """frequency, damping_ratio"""

    def __init__(self, dt: float, at: int) -> None:
        super().__init__(dt, at, 2)

    def forward(self, u: Tensor, load: Tensor, state: Tensor, theta: Tensor, hold: bool) -> Step:
        omega = 2.0 * math.pi * theta[:, self.at]
        fade = theta[:, self.at + 1] * omega
        sine, cosine = damped_sine(fade, omega**2 * (1.0 - theta[:, self.at + 1] ** 2), self.dt)
        a, b, c, d = free_motion(omega, fade, sine, cosine)
        new = torch.isnan(state[:, 0])
        x = torch.where(new, torch.zeros_like(u), state[:, 0] - u)
        v = torch.where(new, torch.zeros_like(u), state[:, 1])
        after, slope = a * x + b * v, c * x + d * v
        y = u - ((slope - v) + 2.0 * fade * (after - x)) / (omega**2 * self.dt)
        return y, torch.stack([u + after, slope], dim=1)


class SecondOrderLag(Part):
    """time_constant, damping_ratio; remembers place and speed of the command, then of the load"""

    def __init__(self, dt: float, at: int) -> None:
        super().__init__(dt, at, 4)

    def forward(self, u: Tensor, load: Tensor, state: Tensor, theta: Tensor, hold: bool) -> Step:
        omega = 1.0 / theta[:, self.at]
        fade = theta[:, self.at + 1] * omega
        sine, cosine = damped_sine(fade, omega**2 * (1.0 - theta[:, self.at + 1] ** 2), self.dt)
        a, b, c, d = free_motion(omega, fade, sine, cosine)
        columns: list[Tensor] = []
        for k in range(2):
            target = u if k == 0 else load
            new = torch.isnan(state[:, 2 * k])
            x = torch.where(new, torch.zeros_like(u), state[:, 2 * k] - target)
            v = torch.where(new, torch.zeros_like(u), state[:, 2 * k + 1])
            columns += [target + a * x + b * v, c * x + d * v]
        return columns[0], torch.stack(columns, dim=1)


class CommandStage(nn.Module):
    """The parts of an axis in their order."""

    def __init__(self, parts: list[Part]) -> None:
        super().__init__()
        self.parts: Any = nn.ModuleList(parts)
        self.width = sum(part.width for part in parts)

    def forward(self, u: Tensor, load: Tensor, state: Tensor, theta: Tensor, hold: bool) -> Step:
        kept = [state[:, :0]]
        first = 0
        for part in self.parts:
            u, after = part(u, load, state[:, first : first + part.width], theta, hold)
            first += part.width
            kept.append(after)
        return u, torch.cat(kept, dim=1)
