"""Native 5-axis B-splines: their spans, and the smooth connection of spans and lines."""
