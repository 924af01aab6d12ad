"""Free motion of a damped oscillator ẍ + 2ζω·ẋ + ω²·x = 0 over one step, exact; compiled."""

import math

from sysid.effects.compiled import inlined

#: Nearer to critical damping than this, in (ω·dt)², the roots are equal.
EQUAL_ROOTS = 1e-12


@inlined
def transition(omega, damping_ratio, s, c, dt):
    """Transition matrix of (x, ẋ) over a step, row by row, into ``s[c:c + 4]``."""
    fade = damping_ratio * omega
    square = omega * omega * (1.0 - damping_ratio * damping_ratio)
    if square * dt * dt > EQUAL_ROOTS:
        root = math.sqrt(square)
        decay = math.exp(-fade * dt)
        sine, cosine = decay * math.sin(root * dt) / root, decay * math.cos(root * dt)
    elif square * dt * dt < -EQUAL_ROOTS:
        root = math.sqrt(-square)
        slow, fast = math.exp((root - fade) * dt), math.exp(-(root + fade) * dt)
        sine, cosine = 0.5 * (slow - fast) / root, 0.5 * (slow + fast)
    else:
        cosine = math.exp(-fade * dt)
        sine = dt * cosine
    s[c] = cosine + fade * sine
    s[c + 1] = sine
    s[c + 2] = -omega * omega * sine
    s[c + 3] = cosine - fade * sine
