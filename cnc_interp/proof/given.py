"""What a proof takes as given: program, machine, tolerances, height, override."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.errors import MachineError
from cnc_interp.core.units import MM, MS
from cnc_interp.machine_model.machine import Machine, find_machine_file
from cnc_interp.proof.plan_files import Columns, PlanFiles

#: Figures of a plan that only the planner knows.
UNPROVEN = 'largest errors, tolerances used, time bound, windows, segments, curves, tool error'
#: Digits of a hash that are shown.
DIGITS = 12


@dataclass(frozen=True)
class Given:
    """One thing that is not proven but given."""

    #: Its name, its value in shop units, and where it comes from.
    what: str
    value: str
    source: str
    sha256: str = ''  #: First digits of the hash of its content, or ''.

    def text(self) -> str:
        """Return it as one line."""
        end = f' (sha256 {self.sha256})' if self.sha256 else ''
        return f'{self.what:<15}{self.value}, from {self.source}{end}'


def given_of(plan: PlanFiles, machine: Machine, name: str, source: Path) -> tuple[Given, ...]:
    """
    List what the proof of a plan takes as given.

    Parameters
    ----------
    plan : PlanFiles
        The plan.
    machine : Machine
        The machine that it is checked with.
    name : str
        Bundled machine or YAML file.
    source : Path
        Folder of the plan, or a bag.

    Returns
    -------
    tuple of Given

    """
    blocks, summary = plan.blocks, plan.summary
    in_bag = not (source / 'blocks.npz').is_file()
    of_blocks = 'the recorded blocks' if in_bag else 'blocks.npz'
    of_summary = 'the bag' if in_bag else 'summary.json'
    file = find_machine_file(name)
    digest = hashlib.sha256(file.read_bytes()).hexdigest()[:DIGITS]
    tolerances = ' and '.join(
        _span(blocks[f'{kind}_tolerance'] / MM) + f' mm {kind}'
        for kind in ('contour', 'orientation')
    )
    rows = [
        Given(
            'program', f'{len(blocks["tip"]) - 1} blocks of {_name(summary)}', of_blocks,
            digest_of(blocks),
        ),
        Given('machine', machine.name, machine_source(machine, file), digest),
        Given('tolerances', tolerances, of_blocks),
        Given('flank height', f'{plan.flank_height / MM:g} mm', of_summary),
        Given('period', f'{plan.period / MS:g} ms', of_summary),
    ]  # fmt: skip
    override = float(summary.get('largest_override', 1.0))
    if override != 1.0:
        rows.append(Given('feed override', f'up to {override:.1%}', of_summary))
    if (source / 'segments.npz').is_file():
        rows += [
            Given('not checked', 'segments.npz, which only the report draws', 'its folder'),
            Given('not checked', UNPROVEN, 'summary.json'),
        ]
    return tuple(rows)


def machine_source(machine: Machine, file: Path) -> str:
    """Say which file a machine was read from, and whether it is a bundled one."""
    if not machine.file:
        return f'the bundled {file.name}'
    try:
        bundled = find_machine_file(machine.name)
    except MachineError:
        bundled = file
    return f'{file}, which is not bundled' + (
        f' and differs from the bundled {machine.name}'
        if bundled.resolve() != file.resolve() and bundled.read_bytes() != file.read_bytes()
        else ''
    )


def digest_of(columns: Columns) -> str:
    """Return the first digits of a hash of the names, types and values of columns."""
    digest = hashlib.sha256()
    for name in sorted(columns):
        column = np.ascontiguousarray(columns[name])
        digest.update(f'{name} {column.dtype.str} {column.shape}'.encode())
        digest.update(column.data)
    return digest.hexdigest()[:DIGITS]


def _name(summary: Mapping[str, Any]) -> str:
    """Return the name of the program, fit for a terminal."""
    name = str(summary.get('program', 'an unnamed program'))
    return ''.join(letter if letter.isprintable() else '?' for letter in name)


def _span(values: FloatArray) -> str:
    """Return least and largest value as text, or one where they are equal."""
    least, most = f'{values.min():g}', f'{values.max():g}'
    return least if least == most else f'{least} to {most}'
