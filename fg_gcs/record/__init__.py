"""What a run leaves behind: the wire's bytes, tables of state and setpoints, events, figures and a report."""
