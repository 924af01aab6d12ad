"""What is known before the search: read ``case`` first, then what it calls in its order.

``clocks``: order of command and sample, and open offsets of clocks. ``noise``: noise of every signal, and noise floors.
``resolution``: steps of sensors. ``measured_input``: estimates of the signals that drive a stage. ``drives``: resonances of
drives, and the delay of a force beside one.
"""
