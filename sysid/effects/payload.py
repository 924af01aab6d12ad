"""``payload``: a mass at the tip that the URDF does not contain."""

from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

EFFECT = Effect(
    name="payload",
    title="Payload",
    sentences=(
        "The tip carries {mass} more than the URDF, with the centre of mass at {centre} in the frame of the tip.",
        "The tip carries {mass} more than the URDF.",
    ),
    part="tool",
    stage="links",
    target="tool",
    slots=(Slot("mass"), Slot("x"), Slot("y"), Slot("z")),
    forms=(
        Form(
            (
                Parameter("mass", "kg", (0.0, 1e4), (1.0,), 0.01, "mass beside that of the URDF"),
                Parameter(
                    "centre",
                    "m",
                    (-1.0, 1.0),
                    (0.0, 0.1),
                    5e-3,
                    "centre of mass in the frame of the tip",
                    sets=(("x",), ("y",), ("z",)),
                    secondary=True,
                ),
            )
        ),
    ),
    equation="τ = Jᵀ(q)·m·(a_c − g): a point mass that the last link carries",
    source="Atkeson, An, Hollerbach, Int. J. Robotics Research 5(3), 1986",
    excited_by="postures in which the arm lifts the mass with several joints",
    confused_with={"link_mass_error": "a payload acts on every joint with the lever of the tip, a link with its own"},
    example={"mass": 2.0, "centre": [0.0, 0.0, 0.05]},
    need=Need("any_motion", 5, "Record joints that lift the arm over their ranges, 30 s."),
    of_links=True,
)
