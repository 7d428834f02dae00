"""Many programs on many machines: each is planned and proven in its own process."""
