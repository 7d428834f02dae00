"""The text of a program: lines, words, expressions, loops and calls, and its dialect."""
