"""Paths without time: poses, splines through them, and the whole swarm along them."""
