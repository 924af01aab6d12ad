"""A simulator of one's own in the gap workflow: its adapter with effects at inputs and outputs, and a surrogate model of it."""
