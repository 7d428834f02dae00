"""Conversion of part programs to other dialects, and of machine files from other formats."""
