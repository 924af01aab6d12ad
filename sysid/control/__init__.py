"""Low-level controller between joint setpoints and valve commands, for one machine or many copies; without torch."""

from sysid.control.cylinder import CylinderController
from sysid.control.tuning import AxisTuning, response_time, simple, tune

__all__ = ["AxisTuning", "CylinderController", "response_time", "simple", "tune"]
