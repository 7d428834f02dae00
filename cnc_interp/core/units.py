"""Shop-floor units in SI: ``0.02 * MM`` is a length in metres. All values in the code are SI."""

from math import pi

MM = 1e-3
UM = 1e-6
INCH = 25.4e-3
DEG = pi / 180.0
ARCSEC = DEG / 3600.0
REV = 2.0 * pi
MINUTE, HOUR = 60.0, 3600.0
MS = 1e-3
MM_PER_MIN = MM / MINUTE
M_PER_MIN = 1.0 / MINUTE
REV_PER_MIN = REV / MINUTE
