"""``backlash``: backlash between drive and structure: the output is at rest while the input crosses it.

Behind a servo both sides have masses: see :func:`sysid.plant.servo_axis.advance`.
"""

import numpy as np

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

EFFECT = Effect(
    name="backlash",
    title="Backlash",
    sentences=("The {target} has a backlash of {width}: at each reversal the drive moves by that much before the joint does.",),
    sentences_by={
        "servo": (
            "The {target} has a backlash of {width} between its motor, whose position the controller reads, and its joint.",
        )
    },
    part="joint",
    stage="joint",
    slots=(Slot("width"),),
    forms=(Form((Parameter("width", "joint", (0.0, 0.1), (0.002, 0.01, 0.03), 2e-4, "full width of the backlash"),)),),
    equation="y = min(max(y, x − width/2), x + width/2); behind a servo, masses move by themselves between the flanks",
    source="Nordin & Gutman, Automatica 38 (2002); pins 0.05–0.3°, slewing rack 0.2–0.8° (machine facts)",
    excited_by="reversals of the axis, slow ones above all",
    confused_with={
        "valve_deadband": "with backlash the cylinder moves a fixed distance before the joint does; a dead-band stops both",
        "stiction": "backlash loses a distance at each reversal; stiction loses a command at each start",
        "coulomb_friction": "friction leaves an error wherever the joint stops; a joint with backlash stops between two flanks",
        "valve_hysteresis": "backlash shows in the position of the joint alone; hysteresis in the speed of the drive",
    },
    example={"width": 0.1},
    rate_independent=True,
    need=Need("reversals", 8, "Record 20 slow reversals of {axis}, with at least 5 % of its range between them."),
    actuations=("velocity", "position", "force", "servo"),
    memory=lambda dt: 2,
    sides=("drive", "structure"),
)


@inlined
def step(x, p, i, s, j):
    """``s[j]`` is the output; set before the first step it is the initial side, NaN starts in the middle.

    ``s[j + 1]`` is its speed behind a servo.
    """
    half = 0.5 * p[i]
    if np.isnan(s[j]):
        s[j] = x
    if s[j] > x + half:
        s[j] = x + half
    elif s[j] < x - half:
        s[j] = x - half
    return s[j]
