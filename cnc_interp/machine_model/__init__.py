"""What a machine is: its file, axes and drives, and tool tip and tool axis <-> axes."""
