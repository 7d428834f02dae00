"""What happens at a vertex between two blocks: it is rounded, stopped at or passed."""
