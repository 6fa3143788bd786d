"""Planning: flux-guided paths, their timing under limits, and plans that prove what they promise."""
