"""The low-level controller between joint setpoints and valve commands. No torch; one machine or many copies side by side."""

from sysid.control.cylinder import CylinderController
from sysid.control.tuning import AxisTuning, response_time, simple, tune

__all__ = ["AxisTuning", "CylinderController", "response_time", "simple", "tune"]
