"""From blocks to smooth segments: corner rounding and orientation connection within tolerance."""
