"""Run `cnc-interp`, the installed command or `python -m cnc_interp`."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType


def main() -> int:
    """Load the commands, which takes a second, and run one; Ctrl-C ends that, too."""
    heeded = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if heeded:
        signal.signal(signal.SIGINT, leave)
    from cnc_interp.commands import cli

    if heeded:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    return cli.main()


def leave(_number: int, _frame: FrameType | None) -> None:
    """End at once: libraries that are being loaded would swallow an exception, or print it."""
    os.write(2, b'cnc-interp: interrupted\n')
    os._exit(130)


if __name__ == '__main__':
    sys.exit(main())
