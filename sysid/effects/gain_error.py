"""``gain_error``: the axis is faster or slower than its nominal gain says."""

from __future__ import annotations

from numba import njit

from sysid.effects.effect import Effect, Form, Parameter, Slot

EFFECT = Effect(
    name="gain_error",
    stage="command",
    target="axis",
    slots=(Slot("ratio", 1.0),),
    forms=(Form((Parameter("ratio", "1", (0.05, 20.0), (0.7, 1.3, 2.0), 0.01, "true gain / nominal gain"),)),),
    equation="v = ratio · gain · x",
    source="definition",
    excited_by="any motion",
    confused_with=("asymmetric_gain", "temperature_drift", "sensor_scale"),
    actuations=("velocity",),
)


@njit(inline="always")
def step(x, p, i):
    return x * p[i]
