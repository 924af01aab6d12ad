"""Alignment of the clocks of devices with the machine's, from motion that both measure, with intervals, also over resets."""
