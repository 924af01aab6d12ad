"""The drive model as a TorchScript module: batched, with explicit state and with one row of parameters for each machine.

A batch has N machines; ``theta`` (N, P) are their parameters, ``u`` and ``load`` (N,) a signal and the gravity load of an axis,
``state`` (N, k) what a part remembers. NaN in a state means that the part has not begun: its first input was held for long.
The equations are those of :mod:`sysid.export.standalone`.
"""
