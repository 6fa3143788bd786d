"""Pictures for people: the report of a run, and the drawn plan."""
