"""Writing a run down while it happens."""
