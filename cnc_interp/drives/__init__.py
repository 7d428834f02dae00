"""Drives and their model: how axes follow, what is left at the tool, and the inverse."""
