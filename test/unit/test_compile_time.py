"""Compiling is told once, and no clock of the work counts it; also that of another process."""

import os
import time

import numpy as np
import pytest
from numba.core.event import install_recorder

from cnc_interp.core import compile_time
from cnc_interp.core.compile_time import CompileTime, working_time
from cnc_interp.core.kernels import njit
from cnc_interp.run.path_chain import Stopwatch


def compile_two():
    """Compile a kernel, and another one that it calls."""

    @njit()
    def inner(x):
        return x + 1.0

    @njit()
    def outer(x):
        return inner(x) * 2.0

    assert outer(1.0) == 4.0


@pytest.fixture
def heard(monkeypatch):
    monkeypatch.setattr(compile_time, 'PATIENCE', 0.0)
    monkeypatch.setattr(compile_time, 'COMPILE_TIME', CompileTime())
    return compile_time.COMPILE_TIME


def test_kernels_that_call_others_count_once_and_are_told_once(heard, capsys):
    began = time.monotonic()
    compile_two()
    compile_two()
    assert 0.0 < heard.seconds <= time.monotonic() - began
    assert capsys.readouterr().err.count(compile_time.COMPILING) == 1


def test_no_stage_of_planning_counts_the_kernels_that_it_compiles(heard):
    watch = Stopwatch()
    began = time.monotonic()
    watch.timed('kinematics', compile_two)
    took, compiled = time.monotonic() - began, heard.seconds
    assert watch.seconds['kinematics'] <= took - compiled
    assert working_time() <= time.monotonic() - compiled


def test_what_a_forked_process_compiles_counts_here(heard):
    child = os.fork()
    if not child:
        compile_two()
        os._exit(0)
    os.waitpid(child, 0)
    assert heard.seconds > 0.0


def test_neither_text_of_errors_nor_an_entry_for_c_is_compiled():
    @njit()
    def put(part, into):
        into[1:4] = part
        return into

    with install_recorder('numba:compile') as recorded:
        assert put(np.ones(3), np.zeros(5)).tolist() == [0.0, 1.0, 1.0, 1.0, 0.0]
    with pytest.raises(ValueError, match='does not fit'):
        put(np.ones(2), np.zeros(5))
    assert all('cfunc' not in code for code in put.inspect_llvm().values())
    compiled = {event.data['dispatcher'].py_func.__module__ for _, event in recorded.buffer}
    assert compiled and 'numba.cpython.unicode' not in compiled
