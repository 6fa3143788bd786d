"""The paper's experiments beside its published numbers, and the benchmark of the planner. Clocks come from outside."""
