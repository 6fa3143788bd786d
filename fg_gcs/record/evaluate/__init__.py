"""Figures and series of a recorded run: from its tables alone."""
