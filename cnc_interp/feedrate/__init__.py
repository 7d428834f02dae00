"""AxisPath -> MotionLaw: the fastest motion within the feed and all axis limits."""
