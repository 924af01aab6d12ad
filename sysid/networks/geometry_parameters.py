"""Parameters of a calibration model: their names, units and prior standard deviations, in the order of a vector.

Priors are Gaussian about the URDF. Sizes, and where they come from:

- displacement of a joint's origin 20 mm and 2°, zero of a joint 2°: an order of magnitude above a manufactured arm's errors
  (0.5 to 3 mm and 0.2 to 1°, machine facts), so that they bound and do not decide;
- scale of a reading 2 %: an encoder counts whole turns, so that a scale error is a wrong gear ratio or a stretched wire;
- deflection 10 mrad (10 mm of a slide) at the largest gravity load of the arm: 0.25° was computed for a crane (machine facts);
  a lightly loaded joint may be up to :data:`SOFTEST` times as soft as the most loaded one;
- lateral deflection 3 mrad at the largest lateral moment of the arm: bearings are several times stiffer across the axis than a
  drive about it;
- place of a marker on its link 0.3 m: the size of a link.

Sources: elastic and geometric parameters together: Khalil and Besnard, IEEE Trans. Robot. Autom. 18 (2002), 915–922; Nubiola
and Bonev, Robot. Comput.-Integr. Manuf. 29 (2013), 236–245; taxonomy of calibration models: Hollerbach and Wampler, Int. J.
Robot. Res. 15 (1996), 573–591.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal["displacement", "scale", "point", "compliance", "lateral"]

#: Prior standard deviations: m, rad, and a share.
PRIOR_LENGTH, PRIOR_ANGLE, PRIOR_SCALE = 0.02, 0.035, 0.02
#: Deflection at the largest load of the arm, of a revolute joint [rad] and of a prismatic one [m]; across the axis [rad].
PRIOR_DEFLECTION, PRIOR_SLIDE_DEFLECTION, PRIOR_LATERAL = 0.01, 0.01, 0.003
#: Place of a marker on its link [m].
PRIOR_MARKER = 0.3
#: Largest ratio of the prior compliances of two joints of an arm.
SOFTEST = 10.0

#: Parameters that are compared with a model that lacks them; the others are always estimated.
OPTIONAL: frozenset[Kind] = frozenset({"scale", "compliance", "lateral"})


@dataclass(frozen=True)
class GeometryParameter:
    """One parameter of a geometry; zero is the value of the URDF.

    Args:
        key: ``boom_joint.x`` and ``boom_joint.rx`` (translation and rotation of its origin, in the origin's frame), ``.offset``
            (along or about the joint's own axis: its zero), ``.scale`` (of its reading), ``.compliance`` (about or along its
            axis under its gravity load), ``.lateral_x`` (tilt about an axis across the joint's under the gravity moment about
            that axis), ``tip.x`` (in the tip's frame), ``<marker>.x`` (in the frame of the marker's link).
        unit: m, rad, 1, rad/(N·m) or m/N.
        prior: standard deviation of the prior.
        kind: what it describes.
        joint: number in the chain of moving joints; −1 of a point.
        part: which of the joint's six displacements or two lateral axes, or which coordinate of the point.
        point: number of the point; −1 of a joint.
    """

    key: str
    unit: str
    prior: float
    kind: Kind = "displacement"
    joint: int = -1
    part: int = 0
    point: int = -1

    @property
    def optional(self) -> bool:
        return self.kind in OPTIONAL
