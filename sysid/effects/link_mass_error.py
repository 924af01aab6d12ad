"""``link_mass_error``: a link is heavier or lighter than in the URDF, by more than the masses of the others are off."""

from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

EFFECT = Effect(
    name="link_mass_error",
    title="Wrong mass of a link",
    sentences=("The link that {target} moves has {ratio} times the mass in the URDF.",),
    part="link",
    stage="links",
    slots=(Slot("ratio", 1.0),),
    forms=(Form((Parameter("ratio", "1", (0.05, 20.0), (0.7, 1.4), 0.01, "true mass / mass in the URDF"),)),),
    equation="(m, m·c, I) = ratio · (m, m·c, I) of the URDF",
    source="Gautier and Khalil, IEEE Trans. Robotics and Automation 6(3), 1990 (base parameters)",
    excited_by="postures in which gravity loads the joint differently",
    confused_with={"load_bias": "the torque of a mass changes with the posture, a constant load does not"},
    need=Need("any_motion", 5, "Record {axis} and the joints before it over their ranges, 30 s."),
    actuations=("force", "servo"),
    ratio_of="mass",
    of_links=True,
)
