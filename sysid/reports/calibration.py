"""A calibration as rows and sentences: parameters, what the poses leave open, and compared models."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sysid.display import NOTHING, digits_for, fixed, quantity
from sysid.networks import Calibration

#: Optional parameters, as sentences name them.
KINDS = {
    "scale": "scales of joint readings",
    "compliance": "joint compliances",
    "lateral": "lateral compliances",
}


def parameter_rows(calibration: Calibration) -> list[tuple[str, ...]]:
    """Name, value, interval, status unless determined, log evidence of an optional one; those not determined are left out."""
    rows: list[tuple[str, ...]] = []
    for found in calibration.parameters:
        if found.status != "not determined":
            low, high = found.interval95
            digits = digits_for(low, high)
            value, *ends = (quantity(each, found.parameter.unit, digits) for each in (found.value, low, high))
            status = "" if found.status == "determined" else found.status
            gain = NOTHING if found.support is None else f"+{found.support.gain:.0f}"
            rows.append((found.parameter.key, value, " … ".join(ends), status, gain))
    return rows


def model_rows(calibration: Calibration) -> list[tuple[str, ...]]:
    """Name, parameters, RMS and median held-out distance, log evidence beside the selected model."""
    rows = []
    for model in calibration.models:
        relative = NOTHING if model.log_evidence is None else fixed(model.log_evidence, 0)
        errors = (quantity(each, "m") for each in (model.held_out_rmse, model.held_out_median))
        rows.append((model.name, str(model.parameters), *errors, relative))
    return rows


def notes(calibration: Calibration) -> Iterator[str]:
    """Sentences: the frame, combinations, ties, kinds of parameters that the poses do not support, a smaller model that
    predicts better."""
    geometry = calibration.geometry
    if not np.array_equal(geometry.frame, np.eye(4)):
        x, y, z = (quantity(value, "m", 4) for value in geometry.frame[:3, 3])
        yield f"The poses are measured in another frame than the URDF's base: the base is at {x}, {y}, {z} in it."
    for combination in calibration.non_identifiable:
        names = ", ".join(name for name, _ in combination)
        many = "cannot be distinguished at these poses" if len(combination) > 1 else "does not move the points"
        yield f"{names}: {many}"
    for found in calibration.parameters:
        if found.support is not None and found.support.alternative is not None:
            yield f"{found.parameter.key} or {found.support.alternative}: these poses do not decide between them"
    present = {parameter.parameter.kind for parameter in calibration.parameters}
    missing = [text for kind, text in KINDS.items() if kind not in present]
    if calibration.supports is not None and missing:
        yield f"Not supported by these poses: {', '.join(missing)}"
    if any(found.parameter.kind == "compliance" for found in calibration.parameters):
        masses = any(mass > 0.0 for mass, _ in geometry.kinematics.masses.values())
        if not masses:
            yield "The URDF has no masses: compliances are per kilogram at the tip."
    better = [model for model in calibration.models[1:] if model.worse < -2.0 * model.standard_error]
    if better:
        best = min(better, key=lambda model: model.worse)
        yield f"The model {best.name!r} predicts held-out poses better than the selected one: record more poses."
