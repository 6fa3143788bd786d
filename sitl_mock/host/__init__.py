"""Vehicles on sockets: one process, one clock."""
