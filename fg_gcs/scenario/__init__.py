"""What is true in a made-up world: how targets move, and what a sensor makes of it."""
