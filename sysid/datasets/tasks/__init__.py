"""An ingest as tasks by recording, for processes and clusters (:mod:`sysid.execution`).

Each task reads the raw files of one recording, or what an earlier task wrote for it in a folder of the dataset without a
version, and returns plain values. What depends on all recordings (skews of clocks, roles, scales of axes) follows in between,
in the caller, which also publishes the version: nobody sees a part of it before.
"""
