"""The logic of one simulated autopilot."""
