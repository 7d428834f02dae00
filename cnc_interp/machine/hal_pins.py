"""Pins of LinuxCNC's HAL for the outputs and inputs of a machine."""

import math

from cnc_interp.core import InterpError
from cnc_interp.machine_model.signals import LOST_MACHINE, Signals

NO_SIGNALS = Signals()
STREAMER, SAMPLER = 'streamer.0', 'sampler.0'
MOST = 21  #: Largest number of columns of a HAL stream.
BITS = 16  #: Bits per column; HAL's ``weighted_sum`` can add this many.
POWER = 'cnc-power'  #: HAL signal that replaces the amplifier enable signals of the joints.


def columns_of(n: int, signals: Signals) -> tuple[str, str]:
    """Return the ``cfg`` texts of ``streamer`` and ``sampler`` for n axes: a letter per column.

    Raises InterpError if more columns are needed than HAL has.
    """
    found = []
    for what, declared, bits, letter in (
        ('streamer', signals.wires, 1, 'u'),
        ('sampler', signals.inputs, n + 2, 's'),
    ):
        numbers = sum(signal.is_number for signal in declared)
        packed = math.ceil((bits + len(declared) - numbers) / BITS)
        found.append('f' * (2 * n + numbers) + letter * packed)
        if len(found[-1]) > MOST:
            raise InterpError(
                f"{what} of LinuxCNC's HAL has at most {MOST} columns, this machine needs "
                f'{len(found[-1])}: name fewer signals in its file'
            )
    return found[0], found[1]


def sent(bit: int) -> str:
    """Return the HAL pin of a ``streamer`` bit; the bits are the power, then the outputs."""
    return f'bits-{bit // BITS}.out-{bit % BITS:02d}'


def seen(bit: int) -> str:
    """Return the HAL pin of a ``sampler`` bit: n faults, power, FIFO empty, then the inputs."""
    return f'wsum.{bit // BITS}.bit.{bit % BITS}.in'


def pins_of(n: int, signals: Signals) -> tuple[dict[str, str], dict[str, str]]:
    """Return the HAL pin of each output and of each input, by the name of the signal.

    The columns of numeric signals come after those of the velocities. An output that must go off
    when the machine node ends passes through a gate.
    """
    outputs, inputs = raw_pins_of(n, signals)
    return outputs | {name: f'{gate}.out' for name, gate, _ in gates(signals)}, inputs


def gates(signals: Signals) -> list[tuple[str, str, str]]:
    """Return name, gate and HAL module of each output that needs the power of the axes."""
    return [
        (signal.name, f'on-{signal.name}', 'mux2' if signal.is_number else 'and2')
        for signal in (signals.outputs[k] for k in signals.off.get(LOST_MACHINE, ()))
    ]


def gate_lines(n: int, signals: Signals) -> list[str]:
    raw, lines = raw_pins_of(n, signals)[0], []
    for name, gate, module in gates(signals):
        value, power = ('in1', 'sel') if module == 'mux2' else ('in0', 'in1')
        lines += [f'net cnc-{gate} {raw[name]} => {gate}.{value}']
        lines += [f'net {POWER} => {gate}.{power}']
    return lines


def raw_pins_of(n: int, signals: Signals) -> tuple[dict[str, str], dict[str, str]]:
    """Return the pins like ``pins_of``; for a gated output, the pin ahead of the gate."""
    outputs, inputs = dict[str, str](), dict[str, str]()
    for pins, declared, name, bit, pin in (
        (outputs, signals.wires, STREAMER, 1, sent),
        (inputs, signals.inputs, SAMPLER, n + 2, seen),
    ):
        number = 2 * n
        for signal in declared:
            pins[signal.name] = f'{name}.pin.{number}' if signal.is_number else pin(bit)
            number, bit = number + signal.is_number, bit + (not signal.is_number)
    return outputs, inputs
