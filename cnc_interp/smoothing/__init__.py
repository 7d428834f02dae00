"""Block -> PathSegment: corner rounding within tolerance, and smooth orientation connection."""
