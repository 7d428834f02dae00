"""Motions that words ask for: single blocks, cycles, threads, splines, planes and probing."""
