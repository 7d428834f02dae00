"""Start, discovery and end of the processes of cnc_interp."""
