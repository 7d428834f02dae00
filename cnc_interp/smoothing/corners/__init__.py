"""One vertex between two blocks: rounded, stopped at, or passed."""
