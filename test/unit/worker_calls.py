"""What workers of a batch are given to do; each of them would repeat heavy imports."""

import os
import signal
import time
from pathlib import Path


def half(number):
    """A function of a worker that fares badly with some numbers."""
    if number == 1:
        os.kill(os.getpid(), signal.SIGSEGV)
    if number == 2:
        os._exit(3)
    if number == 3:
        time.sleep(600.0)
    if number == 4:
        os.kill(os.getpid(), signal.SIGKILL)
    return number / 2


def count_call(path):
    with Path(path).open('a+') as file:
        file.write('x')
        return file.tell()


def stubborn(path):
    """A function of a worker that is killed 30 times, and once is not."""
    times = count_call(path)
    if times <= 30:
        os.kill(os.getpid(), signal.SIGKILL)
    return times


def slow_to_die(seconds):
    """A function of a worker that works for some time [s], and then is killed."""
    time.sleep(seconds)
    os.kill(os.getpid(), signal.SIGKILL)


def lost_with_its_server(path):
    """A function of a worker that dies with the fork server twice."""
    times = count_call(path)
    if times <= 2:
        os.kill(os.getppid(), signal.SIGKILL)
        os.kill(os.getpid(), signal.SIGKILL)
    return times
