"""A machine as links, joints and simple shapes: for URDF readers and for the operator page."""
