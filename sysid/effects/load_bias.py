"""``load_bias``: constant load on a force-actuated axis (gravity, offset of the force measurement)."""

from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

EFFECT = Effect(
    name="load_bias",
    title="Constant load",
    sentences=("A constant load of {force} acts on the {target}.",),
    part="joint",
    stage="force",
    slots=(Slot("force"),),
    forms=(
        Form(
            (Parameter("force", "N or N·m", (-1e6, 1e6), (0.0,), 0.01, "constant load against positive motion", scale="force"),)
        ),
    ),
    equation="M·a = F − friction − force",
    source="Janot, Gautier, Brunot, Data set and reference models of EMPS, 2019",
    excited_by="motion in both directions",
    confused_with={
        "coulomb_friction": "friction changes sign with the motion, a load does not",
        "joint_offset": "an offset changes the tip position; a load changes the force",
    },
    need=Need("force_both_ways", 1, "Record {axis} moving evenly in both directions, 20 s."),
    actuations=("force",),
)
