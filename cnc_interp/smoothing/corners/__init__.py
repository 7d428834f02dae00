"""Vertices between two blocks: each is rounded, stopped at or passed."""
