"""What the planner is measured against: least squares, and planning the way of the paper."""
