"""Run `cnc-interp`, the installed command or `python -m cnc_interp`."""

import os
import signal
import sys
import threading
import time
from importlib import import_module
from pathlib import Path
from types import FrameType
from typing import Any

from cnc_interp.processes.one_thread import use_one_thread
from cnc_interp.processes.stop_signals import STOPS

AGAIN = 0.01  #: Interval at which a lost interrupt is raised again [s].


def main() -> int:
    """Load the commands and run one of them; Ctrl-C and SIGTERM may end either step."""
    use_one_thread()
    usual = (signal.default_int_handler, signal.SIG_DFL)
    heeded = [number for number in STOPS if signal.getsignal(number) in usual]
    for number in heeded:
        signal.signal(number, leave)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})  # ./cnc has blocked it
    from cnc_interp.commands import cli

    sys.unraisablehook = interrupt_again
    for number in heeded:
        signal.signal(number, cli.interrupt)
    return cli.main()


def run_node() -> int:
    """Run the node with the name of the running executable, as `ros2 run` does."""
    use_one_thread()
    node = import_module(f'{__package__}.nodes.{Path(sys.argv[0]).stem}')
    return int(node.main() or 0)


def leave(_number: int, _frame: FrameType | None) -> None:
    """End the process at once; a library that loads could swallow or print an exception."""
    os.write(2, b'cnc-interp: interrupted\n')
    os._exit(130)


def interrupt_again(lost: Any) -> None:
    """Send a lost interrupt again, because Python drops exceptions raised in a finaliser."""
    if issubclass(lost.exc_type, KeyboardInterrupt):
        threading.Thread(target=_send_later, daemon=True).start()
    else:
        sys.__unraisablehook__(lost)


def _send_later() -> None:
    """Send SIGTERM once the main thread has left ``interrupt_again``, where it would be lost."""
    inside = True
    while inside:
        time.sleep(AGAIN)
        frame = sys._current_frames().get(threading.main_thread().ident or 0)
        while frame is not None and frame.f_code is not interrupt_again.__code__:
            frame = frame.f_back
        inside = frame is not None
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == '__main__':
    sys.exit(main())
