"""Orchestration: finds the vehicles, flies the plans, watches over them and always brings them down."""
