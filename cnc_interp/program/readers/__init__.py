"""Readers that convert G-code, Heidenhain plain text and CL data to words and targets."""
