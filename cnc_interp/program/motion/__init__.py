"""Motions of words: single blocks, cycles, threads, splines, planes and probing."""
