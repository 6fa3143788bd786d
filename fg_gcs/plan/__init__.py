"""Planning: flux-guided paths, their timing under limits, and plans that verify what they promise."""
