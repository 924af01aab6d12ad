"""Many machines of one type: differing effects, drifting parameters.

Reading order: ``effects`` (what is compared), ``estimates`` (values in every recording), ``differences`` (between machines),
``drift`` (over time), ``workflow`` (all of it), ``result``.
"""

from sysid.fleet.result import FleetResult
from sysid.fleet.workflow import fleet_gap

__all__ = ["FleetResult", "fleet_gap"]
