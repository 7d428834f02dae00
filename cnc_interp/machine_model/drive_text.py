"""The sections ``loads`` and ``drives`` of a machine file, written again; all else stays."""

from __future__ import annotations

from collections.abc import Mapping

from cnc_interp.machine_model.axis_drives import ENTRIES, AxisDrive, key_and_unit
from cnc_interp.machine_model.drive_loads import LINEAR_KEYS, ROTARY_KEYS, DriveLoad
from cnc_interp.machine_model.machine import Machine

SECTIONS = ('loads', 'drives')


def with_drives(
    text: str,
    machine: Machine,
    drives: Mapping[int, AxisDrive],
    loads: Mapping[int, DriveLoad],
    half_widths: Mapping[int, Mapping[str, float]],
    origin: str,
) -> str:
    """
    Write drives and loads into the text of a machine file.

    Parameters
    ----------
    text : str
        The machine file.
    drives, loads : mapping of int to AxisDrive, DriveLoad
        What to write, for each axis.
    half_widths : mapping of int to mapping of str to float
        Half of the 95 % intervals of the fitted values by field, see ``IdentifiedAxis`` [SI].
    origin : str
        Where the values come from, for a comment.

    Returns
    -------
    str
        Text of the new file.

    """
    parts = [_without_sections(text).rstrip('\n'), '']
    if loads:
        parts += ['# What the drives move and overcome.', 'loads:']
        for j, load in sorted(loads.items()):
            keys = LINEAR_KEYS if machine.is_linear[j] else ROTARY_KEYS
            values = (load.inertia, load.torque, load.coulomb, load.viscous)
            row = [f'{key}: {value:.6g}' for key, value in zip(keys, values, strict=True)]
            parts.append(f'  {machine.axis_names[j]}: {{{", ".join(row)}}}')
            width = half_widths.get(j, {}).get('coulomb')
            if width is not None:
                parts.append(f'  #  +- 95 %: {keys[2]}: {width:.2g}')
        parts.append('')
    parts += [f'# How they follow their setpoints, identified from {origin}.', 'drives:']
    for j, drive in sorted(drives.items()):
        linear, row, widths = bool(machine.is_linear[j]), [], []
        for entry in ENTRIES:
            key, unit = key_and_unit(entry, linear)
            value = getattr(drive, entry.field)
            if value or entry.field == 'feed_forward':
                row.append(f'{key}: {value / unit:.6g}')
            if entry.field in half_widths.get(j, {}):
                widths.append(f'{key}: {half_widths[j][entry.field] / unit:.2g}')
        parts.append(f'  {machine.axis_names[j]}: {{{", ".join(row)}}}')
        if widths:
            parts.append(f'  #  +- 95 %: {", ".join(widths)}')
    return '\n'.join([*parts, ''])


def _without_sections(text: str) -> str:
    """Return the text without its sections of loads and drives, and the comments before them."""
    kept: list[str] = []
    inside = False
    for line in text.splitlines():
        if line.split(':')[0] in SECTIONS:
            inside = True
            while kept and kept[-1].startswith('#'):
                kept.pop()
        elif inside and line and not line[0].isspace() and not line.startswith('#'):
            inside = False
        if not inside:
            kept.append(line)
    return '\n'.join(kept)
