"""The one chain from blocks to chunks of setpoints with stop tails."""
