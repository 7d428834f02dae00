"""The text of a program: lines, words, expressions, loops and calls, and whose dialect it is."""
