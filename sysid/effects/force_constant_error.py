"""``force_constant_error``: the drive makes another force of its command than the simulation assumes.

The torque constant of a motor, the gain of its amplifier or the ratio of its gear is another one. On an arm, the adjusted
parameters of its links contain that ratio.
"""

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

EFFECT = Effect(
    name="force_constant_error",
    title="Wrong force constant",
    sentences=("The {target} makes {ratio} times the commanded force.",),
    part="cylinder",
    stage="force",
    slots=(Slot("ratio", 1.0),),
    forms=(Form((Parameter("ratio", "1", (0.05, 20.0), (0.7, 1.4), 0.01, "true force / commanded force"),)),),
    equation="force = ratio · command",
    source="definition; torque constant of a motor: Hanselman, Brushless Permanent Magnet Motor Design (2003), ch. 4",
    excited_by="acceleration and friction that the simulation describes",
    confused_with={
        "inertia_error": "a wrong force constant changes inertia, friction and load by one ratio; where the simulation "
        "describes no friction, the two are the same",
        "coulomb_friction": "a wrong force constant changes the inertia as well",
        "viscous_friction": "a wrong force constant changes the inertia as well",
    },
    instead_of=("inertia_error",),
    in_links=True,
    need=Need("force_changes", 6, "Record {axis} with fast starts and stops, 20 s."),
    actuations=("force",),
)


@inlined
def step(u, p, i):
    """Command [N or N·m] → force."""
    return p[i] * u
