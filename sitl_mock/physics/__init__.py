"""The world: particles, their numbers, prescribed courses, and where on Earth it is."""
