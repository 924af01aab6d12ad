"""Oil: temperature, viscosity, and the flow through an orifice."""

from __future__ import annotations

import math

from simulated_bench.compiled import compiled


@compiled
def viscosity(time: float, start: float, end: float, warm_up: float, reference: float, thinning: float) -> float:
    """Viscosity over that at the reference temperature while the oil warms up."""
    temperature = end + (start - end) * math.exp(-time / warm_up)
    return math.exp(-thinning * (temperature - reference))


@compiled
def orifice_flow(conductance: float, drop: float, transition: float) -> float:
    """Flow [m³/s] under a pressure drop [Pa]: ``K·Δp/√(|Δp| + Δp_t)``.

    Far above the transition this is ``Cd·w·x·√(2Δp/ρ)`` with ``K = Cd·w·x·√(2/ρ)``; far below it is laminar, hence smooth at
    zero. The transition grows with the square of the viscosity (constant Reynolds number).
    """
    return conductance * drop / math.sqrt(abs(drop) + transition)
