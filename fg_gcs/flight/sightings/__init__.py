"""Where sightings of moving targets come in."""
