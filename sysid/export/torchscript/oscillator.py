"""Exact steps of a damped oscillator, and parameters that may be absent."""

import torch
from torch import Tensor


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
