"""The program as a library: plan, fly and report a mission without printing."""
