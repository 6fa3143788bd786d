"""How a formation follows what is known: axes, its frame in time, trajectories that end at rest, replanning."""
