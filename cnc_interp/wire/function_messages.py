"""Functions of a program <-> ROS messages, and their checks."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import Function, MachineSignals

from cnc_interp.core.errors import StreamError
from cnc_interp.machine.switching import Act
from cnc_interp.machine_model.signals import Signals
from cnc_interp.program.functions import Functions


def function_messages(functions: Functions, first: int, signals: Signals) -> list[Function]:
    """Convert consecutive functions of a run, numbered from ``first``, to messages."""
    columns = (column.tolist() for column in functions.columns().values())
    rows = zip(*columns, strict=True)
    return [_message(number, row, signals) for number, row in enumerate(rows, first)]


def act_message(act: Act, sample: int, signals: Signals) -> Function:
    """Convert what was set, before a setpoint of the run."""
    row = act.block, act.line, act.place, act.value, act.before_stop
    message = _message(act.number, row, signals)
    message.sample = sample
    return message


def _message(number: int, row: tuple[Any, ...], signals: Signals) -> Function:
    block, line, step, value, before_stop = row
    output = signals.outputs[signals.steps[step].output].name
    return Function(
        number=number, sequence=block, line_number=line, step=step, output=output, value=value,
        before_stop=before_stop,
    )  # fmt: skip


def functions_from(messages: Sequence[Function]) -> Functions:
    rows = [(m.sequence, m.line_number, m.step, m.value, m.before_stop) for m in messages]
    return Functions.of_rows(np.array(rows, dtype=float).ravel())


def check_functions(name: str, messages: Sequence[Function], signals: Signals) -> None:
    """Refuse functions with gaps, out of order, or that the machine file does not have."""
    for before, message in pairwise(messages):
        if message.number != before.number + 1 or message.sequence < before.sequence:
            raise StreamError(f'{name}: function {message.number} does not follow')
    for message in messages:
        known = message.step < len(signals.steps)
        output = signals.outputs[signals.steps[message.step].output] if known else None
        if output is None or output.name != message.output:
            text = f'function {message.number} sets {message.output!r}, which the machine file'
            raise StreamError(f'{name}: {text} does not; give all nodes the same machine')
        if fault := output.fault_of(message.value):
            raise StreamError(f'{name}: function {message.number}: {fault}')


def signals_message(
    signals: Signals, outputs: Sequence[float], inputs: Sequence[float]
) -> MachineSignals:
    return MachineSignals(
        outputs=[signal.name for signal in signals.outputs], output_values=list(outputs),
        output_is_number=[signal.is_number for signal in signals.outputs],
        inputs=[signal.name for signal in signals.inputs], input_values=list(inputs),
    )  # fmt: skip
