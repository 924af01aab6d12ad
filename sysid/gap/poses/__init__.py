"""The end-effector stage of a dataset of static poses alone: kinematic calibration as a choice among effects.

``folds`` deals poses to fit, selection and test; ``tangents`` are errors of an arm that no effect describes; ``regression`` is
the likelihood of the poses; ``search`` compares sets of effects in it; ``stage`` goes from poses to a decision.
"""
