"""Starts real SITL instances that the user has, watches them until each can be armed, and ends them."""
