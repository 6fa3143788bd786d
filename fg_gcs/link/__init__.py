"""Sockets and clocks: the only room where bytes move and time passes."""
