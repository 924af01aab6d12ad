"""Frames of the shipped files, in plain Python and NumPy: the kernels that they call are shipped beside them as source."""
