"""A part program in another dialect."""
