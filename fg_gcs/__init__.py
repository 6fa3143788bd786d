"""Flux-guided ground control for swarms of simulated MAVLink vehicles; :mod:`fg_gcs.run` is its public face."""
