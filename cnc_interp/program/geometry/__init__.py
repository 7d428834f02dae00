"""The geometry of targets: arcs, frames, cutter compensation, subdivision; without modal state."""
