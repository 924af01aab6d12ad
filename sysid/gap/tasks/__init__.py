"""The search of a gap as tasks by stage, for processes and clusters (:mod:`sysid.execution`).

Each task opens the dataset and the plant from the workspace, searches one stage and returns its result as plain values; the
caller does the rest.
"""
