"""Low-level controller between joint setpoints and valve commands, for one machine or many copies; without torch."""

from sysid_rl.control.cylinder import CylinderController
from sysid_rl.control.tuning import AxisTuning, lookahead_time, proportional_tuning, response_time, tune

__all__ = ["AxisTuning", "CylinderController", "lookahead_time", "proportional_tuning", "response_time", "tune"]
