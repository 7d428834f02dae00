"""Offsets and tools of the machine as messages."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from cnc_interp_msgs.msg import Offset, SetupTable, Tool

from cnc_interp.program.job import JobSetup, Position


def setup_table(
    setup: JobSetup,
    file: str,
    zero: Mapping[str, float],
    program_id: str,
    in_use: Iterable[str],
    by: str,
    what: str,
) -> SetupTable:
    """
    Return the message about the setup of the machine.

    Parameters
    ----------
    setup : JobSetup
        Offsets and tools.
    file : str
        Path of the setup file, or empty.
    zero : mapping of str to float
        Workpiece zero of the machine file by axis letter [m, rad].
    program_id : str
        The run that began with it; empty without one.
    in_use : iterable of str
        What the program that runs uses.
    by, what : str
        The last change: who made it, and what it was.

    """
    return SetupTable(
        file=file,
        work_offsets=_offsets(setup.work_offsets),
        axes=list(zero),
        zero=list(zero.values()),
        active=setup.offset,
        g92=_offset('G92', setup.g92),
        g92_on=setup.g92_on,
        tools=[
            Tool(number=number, length=tool.length, radius=tool.radius, remark=tool.remark)
            for number, tool in sorted(setup.tools.items())
        ],
        tool=setup.tool,
        reference_points=_offsets(setup.reference_points),
        program_id=program_id,
        in_use=sorted(in_use),
        changed_by=by,
        change=what,
        text=setup.text() if setup != JobSetup() else '',
    )


def _offsets(positions: Mapping[str, Position]) -> list[Offset]:
    """Return positions as messages, in the order of their names."""
    return [_offset(name, positions[name]) for name in sorted(positions)]


def _offset(name: str, position: Position) -> Offset:
    """Return one position as a message."""
    return Offset(name=name, axes=list(position), values=list(position.values()))
