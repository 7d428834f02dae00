"""From tool path (PathSegments) to machine axes (AxisPath), with exact derivatives."""
