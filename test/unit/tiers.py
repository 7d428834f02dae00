"""How many examples a test tries: few with every change, many with ``--all``."""

import os

#: Set by ``--all`` before any test is collected.
thorough = False


def examples(few: int, many: int) -> int:
    """Examples to try; the environment variable CNC_INTERP_EXAMPLES overrides both numbers."""
    return int(os.environ.get('CNC_INTERP_EXAMPLES', many if thorough else few))
