"""Motion capture: markers and rigid bodies → joints and points in the base frame, and proposals for the capture frame."""
