"""Native 5-axis B-splines: their spans and their connection."""
