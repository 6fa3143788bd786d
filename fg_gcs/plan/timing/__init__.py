"""When a path is flown: time-optimal under norm limits, then with continuous acceleration."""
