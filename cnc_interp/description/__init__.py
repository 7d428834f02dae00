"""Describe a machine by links, joints and simple shapes, for URDF and for the page."""
