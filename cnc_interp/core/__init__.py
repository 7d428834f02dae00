"""Shared ground of all rooms: arrays, units, errors, jets, Bezier spans."""
