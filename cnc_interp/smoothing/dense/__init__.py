"""Compression: runs of short blocks become smooth curves within the tolerances."""
