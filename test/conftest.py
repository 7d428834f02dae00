"""Let tests import their shared builders (``programs``, ...) by name."""

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent / folder) for folder in ('unit', 'ros', 'page')]
