"""Plan the fastest motion along an AxisPath within the feed and all axis limits."""
