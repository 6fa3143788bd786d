"""Flux-guided ground control for swarms of simulated MAVLink vehicles."""
