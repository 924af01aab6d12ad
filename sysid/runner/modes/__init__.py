"""What a run is for: follow, hold, collect, replay, watch."""
