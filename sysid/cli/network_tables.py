"""Console output of networks: errors, errors by direction, coverage of intervals, spikes; and calibrated geometries."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sysid.display import NOTHING, fixed, percent, quantity, shown_unit

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from sysid.cli.output import Printer
    from sysid.networks import Calibration
    from sysid.validate import ValidationReport

#: Spikes that are listed for each output.
MAX_SPIKES = 3
#: Optional parameters of a geometry, as sentences name them.
KINDS = {
    "scale": "scales of joint readings",
    "compliance": "joint compliances",
    "lateral": "lateral compliances",
}


def show_errors(out: Printer, *reports: ValidationReport, paper: Mapping[str, float] | None = None) -> None:
    """One row per output: RMSE, 95 %, maximum, noise floor, and the best simpler model.

    ``paper`` adds a column with a published maximum [SI] by output.
    """
    from sysid.reports.result_figures import network_rows

    rows = [row for report in reports for row in network_rows(report, paper)]
    beside = [] if paper is None else ["paper's max"]
    header = ("network output", "rows", "rmse", "95 %", "max", *beside, "noise", "unit", "best simple model")
    out.table(header, rows, right=range(2, 6 + len(beside)))
    for report in reports:
        if report.recommendation:
            out.line(f"{report.model or report.kind}: {report.recommendation}")


def show_directions(out: Printer, report: ValidationReport) -> None:
    """Errors of actuator networks by the direction of motion, which indicate backlash or hysteresis."""
    rows = []
    for entry in report.outputs if report.kind in ("actuator", "history") else ():
        factor, unit = shown_unit(entry.unit)
        for found in entry.profiles:
            if found.variable.startswith("direction of ") and entry.rows == "motion":
                figures = [
                    f"{factor * bias:+.2f} / {factor * rmse:.2f}" if count else NOTHING
                    for count, bias, rmse in zip(found.count, found.bias, found.rmse, strict=True)
                ]
                floor = NOTHING if entry.noise_floor is None else f"{factor * entry.noise_floor:.2f}"
                rows.append((entry.output, *figures, floor, unit))
    header = ("by direction of the input: bias / rmse", "falling", "still", "rising", "noise", "unit")
    out.table(header, rows, right=range(1, 5))


def show_coverage(out: Printer, report: ValidationReport) -> None:
    """Coverage of the intervals of each output, and its largest errors."""
    from sysid.reports.result_figures import spike_sentence

    for entry in report.outputs:
        if entry.coverage is not None:
            level, width = percent(entry.coverage.level), quantity(entry.coverage.half_width, entry.unit)
            held, flagged = percent(entry.coverage.covered), percent(entry.coverage.flagged)
            out.line(f"{level} intervals of {entry.output}, {entry.rows}: ± {width}, coverage {held}; {flagged} flagged")
    for entry in report.outputs:
        for spike in entry.spikes[:MAX_SPIKES]:
            out.line(f"spike in {spike_sentence(entry, spike)}")


def show_calibration(out: Printer, calibration: Calibration) -> None:
    """Parameters that the poses determine, those that they leave open, and the models that were compared."""
    header = ("parameter", "differs from the URDF by", "95 % interval", "", "log evidence")
    out.table(header, _parameter_rows(calibration), right=(1, 2, 4))
    for line in _notes(calibration):
        out.line(f"  {line}")
    rows = []
    for model in calibration.models:
        relative = NOTHING if model.log_evidence is None else fixed(model.log_evidence, 0)
        errors = (quantity(each, "m") for each in (model.held_out_rmse, model.held_out_median))
        rows.append((model.name, model.parameters, *errors, relative))
    header = ("model", "parameters", "held-out RMS distance", "median", "log evidence")
    out.table(header, rows, right=(1, 2, 3, 4))


def _parameter_rows(calibration: Calibration) -> list[tuple[str, ...]]:
    """Name, value, interval, status unless determined, log evidence of an optional one; those not determined are left out."""
    from sysid.figures import ParameterFigure

    rows: list[tuple[str, ...]] = []
    for found in calibration.parameters:
        if found.status != "not determined":
            figure = ParameterFigure(found.parameter.key, found.parameter.unit, found.value, found.interval95)
            status = "" if found.status == "determined" else found.status
            gain = NOTHING if found.support is None else f"+{found.support.gain:.0f}"
            rows.append((figure.name, figure.text, figure.interval, status, gain))
    return rows


def _notes(calibration: Calibration) -> Iterator[str]:
    """Sentences: the frame, combinations, ties, kinds of parameters that the poses do not support, a smaller model that
    predicts better."""
    import numpy as np

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
    if "compliance" in present and not any(mass > 0.0 for mass, _ in geometry.kinematics.masses.values()):
        yield "The URDF has no masses: compliances are per kilogram at the tip."
    better = [model for model in calibration.models[1:] if model.worse < -2.0 * model.standard_error]
    if better:
        best = min(better, key=lambda model: model.worse)
        yield f"The model {best.name!r} predicts held-out poses better than the selected one: record more poses."
