"""``load_bias``: a constant load on a force-actuated axis (gravity, offset of the force measurement)."""

from __future__ import annotations

from sysid.effects.effect import Effect, Form, Parameter, Slot

EFFECT = Effect(
    name="load_bias",
    stage="force",
    target="axis",
    slots=(Slot("force"),),
    forms=(Form((Parameter("force", "N or N·m", (-1e6, 1e6), (0.0,), 0.0, "load: M·a = force − friction − load_bias"),)),),
    equation="M·a = F − friction − force",
    source="Janot, Gautier, Brunot, Data set and reference models of EMPS, 2019",
    excited_by="motion in both directions",
    confused_with=("coulomb_friction", "joint_offset"),
    actuations=("force",),
)
