"""``inertial_error``: differences of a link's inertial parameters from the URDF, adjusted together and never named.

Measured torques determine combinations of the parameters of several links only (base parameters), so that a value here means
little by itself; together they give the torques. A wrong constant between current and force of an axis is among them: it scales
what the links load that axis with.
"""

from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

_ANY = (-1e6, 1e6)
_AXES = ("xx", "xy", "yy", "xz", "yz", "zz")

EFFECT = Effect(
    name="inertial_error",
    title="Inertial parameters of a link",
    sentences=("The inertial parameters of the link that {target} moves differ from the URDF.",),
    part="link",
    stage="links",
    slots=(
        Slot("mass"),
        *(Slot(f"h{axis}") for axis in "xyz"),
        *(Slot(f"i{axes}") for axes in _AXES),
        Slot("rotor"),
        Slot("scale", 1.0),
    ),
    forms=(
        Form(
            (
                Parameter("mass", "kg", _ANY, (0.0,), 0.01, "of the link, beside the URDF"),
                Parameter(
                    "first_moment", "kg·m", _ANY, (0.0,), 1e-3, "mass times centre", sets=tuple((f"h{a}",) for a in "xyz")
                ),
                Parameter(
                    "inertia", "kg·m²", _ANY, (0.0,), 1e-3, "xx, xy, yy, xz, yz, zz", sets=tuple((f"i{a}",) for a in _AXES)
                ),
                Parameter("rotor", "kg·m²", _ANY, (0.0,), 1e-3, "inertia of the rotor at the joint, beside machine.toml"),
                Parameter("scale", "1", (0.05, 20.0), (1.0,), 1e-3, "measured over true force of the links at this axis"),
            )
        ),
    ),
    equation="τ = scale·Y(q, q̇, q̈)·(π + Δπ) + rotor·q̈, π about the frame of the joint",
    source="Gautier and Khalil, IEEE Trans. Robotics and Automation 6(3), 1990 (base parameters)",
    excited_by="motion of all joints at once",
    confused_with={"inertia_error": "one ratio of the axis' inertia; the parameters of links change torques with the posture"},
    example={"mass": 0.5, "first_moment": [0.0, 0.0, 0.1], "inertia": [0.0] * 6, "rotor": 0.1, "scale": 0.95},
    need=Need("any_motion", 5, "Record {axis} and all other joints over their ranges, 30 s."),
    actuations=("force",),
    fitted=False,
    of_links=True,
)
