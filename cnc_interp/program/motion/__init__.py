"""The motions that words command: single blocks, cycles, threads, splines, planes and probing."""
