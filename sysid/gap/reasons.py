"""Why an effect has no name: the condition that it fails, or the explanation that takes its place."""

from __future__ import annotations

from enum import StrEnum


class Reason(StrEnum):
    """A sentence of results; ``plain``: the same for the console, where it differs."""

    plain: str

    def __new__(cls, sentence: str, plain: str = "") -> Reason:
        made = str.__new__(cls, sentence)
        made._value_, made.plain = sentence, plain or sentence
        return made

    NOT_EXCITED = "the recordings do not excite it enough"
    UNCERTAIN = (
        "its 95 % interval reaches into the region of practical equivalence",
        "its interval includes values too small to matter",
    )
    AT_BOUND = "a value ends at a bound of its range, so that something else is missing"
    REPLACED = "a model without it predicts as well", "the simulation predicts as well without it"
    LITTLE = (
        "it reduces the error by too little compared with what remains",
        "it lowers the error by little compared with what remains",
    )
    LOST = (
        "on recordings left out of the fit it reduces the error by too little compared with what remains",
        "it lowers the error on recordings left out of the fit by too little",
    )
    # Other explanations.
    REPAIRS = (
        "it may compensate for the formula of a similar effect",
        "it may stand in for the wrong formula of a similar effect",
    )
    REFUTED = "the drive in front of this sensor shows the right speed without it, and needs a further effect with it"
    PERIODIC = "a disturbance that is periodic in time explains the error better"
    POSITION = "a smooth function of the position explains the error better"
    SAG = "sag under the gravity load of the axis looks the same"
    LINKS = "the inertial parameters of its link are adjusted, and these recordings determine the sum of both"
    WEIGHT = "its force depends on the posture of the joints, as by gravity: give the masses of the links (a URDF)"
    ESTIMATED = "the description only estimates this value: it is a better one"
