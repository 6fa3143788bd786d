"""MAVLink as the simulated autopilots speak it: messages in and out."""
