"""The drive model as a TorchScript module: batched, with explicit state and with one row of parameters for each machine.

A batch has N machines; ``theta`` (N, P) are their parameters. The equations are the kernels of the plant: their source is
followed (:mod:`.kernels`) and recorded as operations on columns (:mod:`.graph`), which are written as TorchScript
(:mod:`.source`). A new effect of the plant is therefore in the module as well.
"""
