"""Many machines of one type: differing effects, drifting parameters.

Reading order: ``effects`` (what is compared), ``estimates`` (names on a machine, values in every recording), ``differences``
(between machines), ``drift`` (over time), ``workflow`` (all of it), ``watching`` (one machine, as its logs arrive), ``result``.
"""

from sysid.fleet.result import FleetResult
from sysid.fleet.watching import WatchResult, watch
from sysid.fleet.workflow import fleet_gap

__all__ = ["FleetResult", "WatchResult", "fleet_gap", "watch"]
