"""Collision check: bodies of machine, tools, clamps and stock along the path q(s)."""
