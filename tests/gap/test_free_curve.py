"""A name of a shape does not stand for a speed of another shape."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from plant_data import nominal
from slew_search import named_at_slew, slewing

from sysid.gap.strictness import Strictness

Array = npt.NDArray[np.float64]


def slipping(command: Array) -> Array:
    """A clutch that loses a seventh of the speed where it has to pass on much."""
    return command * np.where(np.abs(command) > 0.4, 0.86, 1.0)


def progressive(command: Array) -> Array:
    return np.asarray(np.sign(command) * np.abs(command) ** 1.2)


def test_a_clutch_that_slips_is_no_gain_and_no_curve() -> None:
    dataset = slewing(slipping)
    assert named_at_slew(dataset, nominal(), Strictness()) == set()
    assert named_at_slew(dataset, nominal(), Strictness(shapeless=np.inf)) & {"gain_curve", "gain_error", "flow_saturation"}


def test_a_curve_is_one() -> None:
    assert named_at_slew(slewing(progressive), nominal(), Strictness()) == {"gain_curve"}
