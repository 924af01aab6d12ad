"""Checks of channels at ingest and of datasets before a fit: units, signs, columns, sensors, the description of the machine.

:mod:`~sysid.datasets.checks.run` lists all of them. A check of a channel looks at its samples
(:class:`~sysid.datasets.checks.flag.SignalSamples`) and returns flags, which are stored. A check of a dataset looks at its
tables and figures (:class:`~sysid.datasets.checks.figures.CheckContext`) and returns findings
(:class:`~sysid.datasets.checks.finding.Finding`): what was found, what was expected, the likely cause and its remedy.
"""
