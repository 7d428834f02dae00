"""AxisPath -> chunks of setpoints with their stop tails; planned anew at any sample."""
