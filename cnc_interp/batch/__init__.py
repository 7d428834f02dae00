"""Plan and prove many programs on many machines, each in its own process."""
