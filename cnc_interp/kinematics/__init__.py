"""PathSegment -> AxisPath: tool tip and tool axis <-> machine axes, with exact derivatives."""
