"""Files that a mission comes in, one module a format."""
