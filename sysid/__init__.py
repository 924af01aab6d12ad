"""System identification for machines: logs in, named sim-to-real gaps out.

The public API is the sub-packages, in the order in which data walks through them::

    sysid.logs → sysid.datasets → sysid.networks, sysid.plant → sysid.gap → sysid.reports, sysid.view

Importing this package loads none of them.
"""

__version__ = "0.1.0"
