"""CAM: iso-scallop tool paths from surfaces [TL2008], and an N-buffer that proves them."""
