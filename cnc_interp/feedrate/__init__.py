"""AxisPath -> MotionLaw: as fast as the feed and all axis limits allow, jerk included."""
