"""Everything between the blocks of a program and chunks of setpoints with stop tails."""
