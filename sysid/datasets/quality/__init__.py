"""What recordings contain, in numbers: noise, use of the axes, responses, coverage, completeness. :mod:`sysid.datasets.checks`
says what is wrong with them.
"""
