"""Which effect names count as right for what is hidden. The one place to adapt when effects are added or renamed.

A coarse name describes the hidden effect in a simpler form: nothing is wrongly named, but the case does not count as right.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Accepted:
    """An effect name that counts.

    Args:
        parameters: parameter of the effect → key of the truth it is compared with.
        coarse: whether the name is a simpler form of what is hidden.
        anywhere: whether the effect may have any axis, link or tool as target.
    """

    name: str
    parameters: Mapping[str, str] = field(default_factory=dict)
    coarse: bool = False
    anywhere: bool = False


#: Hidden name → what counts, the first match wins.
ACCEPTED: dict[str, tuple[Accepted, ...]] = {
    "viscous_friction": (Accepted("viscous_friction", {"coefficient": "coefficient"}),),
    "coulomb_friction": (Accepted("coulomb_friction", {"force": "force"}),),
    "payload": (Accepted("payload", {"mass": "mass"}, anywhere=True),),
    # Masses of the URDF are off; every inertial error of any link is a right name, and none is due.
    "link_inertia": (
        Accepted("link_mass_error", anywhere=True),
        Accepted("inertial_error", anywhere=True),
        Accepted("inertia_error", anywhere=True),
    ),
    # A proportional servo with damping: any form of its lag.
    "servo_lag": (Accepted("first_order_lag"), Accepted("second_order_lag"), Accepted("servo_resonance")),
    "input_delay": (Accepted("input_delay", {"delay": "delay"}),),
    **{
        name: (Accepted(name, {key: key}),)
        for name, key in (
            ("armature_error", "ratio"),
            ("stiffness_error", "ratio"),
            ("damping_error", "ratio"),
            ("link_mass_error", "ratio"),
            ("force_limit", "limit"),
            ("backlash", "width"),
        )
    },
    "joint_compliance": (Accepted("joint_compliance", {"compliance": "compliance"}),),
    "joint_offset": (Accepted("joint_offset", {"offset": "offset"}),),
    "link_length_error": (Accepted("link_length_error", {"error": "error"}),),
    "base_misalignment": (Accepted("base_misalignment", {"translation": "translation", "rotation": "rotation"}),),
    "flexible_drive": (Accepted("flexible_drive", {"frequency": "frequency", "inertia_ratio": "inertia_ratio"}),),
    # Behind a speed servo the load is a second-order system: the formula of oil_compressibility.
    "flexible_drive_velocity": (
        Accepted("flexible_drive", {"frequency": "frequency"}),
        Accepted("oil_compressibility", {"frequency": "frequency"}),
    ),
    "smooth_coulomb_friction": (
        Accepted("smooth_coulomb_friction", {"force": "force"}),
        Accepted("coulomb_friction", coarse=True),
    ),
    "load_dependent_friction": (
        Accepted("load_dependent_friction", {"coefficient": "coefficient"}),
        Accepted("coulomb_friction", coarse=True),
    ),
    "lugre_friction": (
        Accepted("lugre_friction", {"coulomb_force": "force"}),
        Accepted("stribeck_friction", coarse=True),
        Accepted("smooth_coulomb_friction", coarse=True),
        Accepted("coulomb_friction", coarse=True),
    ),
}
#: Keys of an entry of ``unnamed`` that state a resonance [Hz].
RESONANCE = ("resonance_hz", "resonance", "frequency_hz", "frequency")
