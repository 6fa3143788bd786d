"""Moving targets: sightings, what is known from them, and motions that follow it within all limits."""
