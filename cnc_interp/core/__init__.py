"""What all packages use: array types, units, errors, jets, B-splines and Bezier pieces."""
