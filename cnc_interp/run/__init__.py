"""Blocks to chunks of setpoints with stop tails: one chain for everybody."""
