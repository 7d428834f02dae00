"""How the processes of cnc_interp start, find each other, and end."""
