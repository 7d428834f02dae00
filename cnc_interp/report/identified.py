"""The pages about identified drives, and about limits fitted to measured times."""

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from cnc_interp.core import ARCSEC, MM_PER_MIN, UM, FloatArray
from cnc_interp.drives.identification import IdentifiedAxis
from cnc_interp.machine_model import axis_drives
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.machine_entries import STOPS
from cnc_interp.report import html
from cnc_interp.report.series import extremes
from cnc_interp.run.time_fit import Fitted, TracedRun

#: Length of a window of the measured transfer function [s]; least coherence that is shown.
WINDOW, COHERENCE = 0.5, 0.8
LOWEST, HIGHEST = 1.0, 120.0  #: Range of the Bode plot [Hz].


def values_of(
    machine: Machine, found: IdentifiedAxis
) -> Iterator[tuple[str, float, float | None]]:
    """Yield key of the machine file, value and half of its 95 % interval, in the file's unit."""
    linear = bool(machine.is_linear[found.axis])
    if found.load is not None:
        keys = axis_drives.LINEAR_KEYS if linear else axis_drives.ROTARY_KEYS
        yield keys[2], found.load.coulomb, found.half_width.get('coulomb')
    for entry in axis_drives.ENTRIES:
        key, unit = axis_drives.key_and_unit(entry, linear)
        width = found.half_width.get(entry.field)
        yield (
            key,
            getattr(found.drive, entry.field) / unit,
            None if width is None else width / unit,
        )


def identified_lines(machine: Machine, found: Mapping[int, IdentifiedAxis]) -> list[str]:
    lines = []
    for axis, each in found.items():
        lines.append(f'{machine.axis_names[axis]}: {_residual(machine, each)}')
        for key, value, width in values_of(machine, each):
            known = '' if width is None else f' +- {width:.2g}'
            lines.append(f'  {key:22s} {value:.6g}{known}')
        if each.load is None:
            lines.append('  friction not fitted: give the axis under loads in the machine file')
    return lines


def _residual(machine: Machine, found: IdentifiedAxis) -> str:
    unit, name = _unit(machine, found.axis)
    off = (found.measured - found.modelled) / unit
    follows = (found.setpoint - found.measured) / unit
    return (
        f'model off by {np.std(off):.3g} {name} (root mean square), {np.abs(off).max():.3g} '
        f'{name} at most; following error up to {np.abs(follows).max():.3g} {name}'
    )


def _unit(machine: Machine, axis: int) -> tuple[float, str]:
    return (UM, 'um') if machine.is_linear[axis] else (ARCSEC, 'arcsec')


def write_identified(
    machine: Machine, found: Mapping[int, IdentifiedAxis], period: float, out: Path
) -> None:
    sections = []
    for axis, each in found.items():
        rows = ''.join(
            f'<tr><th>{escape(key)}</th><td>{value:.6g}</td>'
            f'<td>{"" if width is None else f"&plusmn; {width:.2g}"}</td></tr>'
            for key, value, width in values_of(machine, each)
        )
        table = f'<table><tbody>{rows}</tbody></table>'
        both = _time_figure(machine, each, period), _bode(each, period)
        figures = ''.join(map(html.drawing, both))
        name, told = machine.axis_names[axis], escape(_residual(machine, each))
        sections.append(html.section(name, told, table + figures))
    title = f'Drives of {machine.name}'
    body = f'<h1>{escape(title)}</h1><p>Fitted to a recorded run; intervals of 95 %.</p>'
    html.write(out, title, body + ''.join(sections))


def _time_figure(machine: Machine, found: IdentifiedAxis, period: float) -> Any:
    from plotly.subplots import make_subplots

    unit, name = _unit(machine, found.axis)
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.06)
    time = found.rows * period
    curves = (
        (1, 'following error measured', found.setpoint - found.measured, html.BLUE),
        (1, 'following error modelled', found.setpoint - found.modelled, html.ORANGE),
        (2, 'measured minus modelled', found.measured - found.modelled, html.RED),
    )
    for row, title, curve, colour in curves:
        kept = extremes(curve, html.BUCKETS)
        dash = 'dot' if colour == html.ORANGE else 'solid'
        line = {'color': colour, 'width': 1.2, 'dash': dash}
        html.add_curve(figure, row, time[kept], curve[kept] / unit, title, line, mode='lines')
    figure.update_xaxes(range=[float(time[0]), float(time[-1])])  # where the motion ends
    figure.update_xaxes(title_text='time [s]', row=2, col=1)
    figure.update_yaxes(title_text=f'[{name}]')
    return html.laid_out(figure, 420)


def transfer(drive: axis_drives.AxisDrive, viscous: float, frequency: FloatArray) -> FloatArray:
    """Return the linear response of an axis to its setpoint, without backlash and friction."""
    s = 2j * np.pi * frequency
    kv, f, tau = drive.position_gain, drive.feed_forward, drive.time_constant
    answer = (f * s + kv) / (tau * s**2 + (1.0 + tau * viscous) * s + kv)
    if drive.mode_frequency:
        omega, zeta = 2.0 * np.pi * drive.mode_frequency, drive.mode_damping
        answer *= (2 * zeta * omega * s + omega**2) / (s**2 + 2 * zeta * omega * s + omega**2)
    linear: FloatArray = answer * np.exp(-drive.delay * s)
    return linear


def _measured_transfer(found: IdentifiedAxis, period: float) -> tuple[FloatArray, FloatArray]:
    """Return frequencies and coherent responses; windows with reversals are left out."""
    # Differences, so that the drift of positions does not leak over all frequencies.
    given, did = np.diff(found.setpoint), np.diff(found.measured)
    size = round(WINDOW / period)
    frequency, taper = np.fft.rfftfreq(size, period), np.hanning(size)
    power, answer, across = np.zeros((3, len(frequency)), dtype=complex)
    for first in range(0, len(given) - size, size // 4):
        rows = slice(first, first + size)
        whole = found.rows[first + size] - found.rows[first] == size
        if whole and (np.all(given[rows] > 0.0) or np.all(given[rows] < 0.0)):
            parts = given[rows], did[rows]
            spectra = [np.fft.rfft(taper * (part - np.mean(part))) for part in parts]
            power += np.abs(spectra[0]) ** 2
            answer += np.abs(spectra[1]) ** 2
            across += np.conj(spectra[0]) * spectra[1]
    known = (power.real > 0.0) & (frequency >= LOWEST) & (frequency <= HIGHEST)
    known[known] &= np.abs(across[known]) ** 2 > COHERENCE * (power * answer).real[known]
    return frequency[known], across[known] / power[known]


def _bode(found: IdentifiedAxis, period: float) -> Any:
    from plotly.subplots import make_subplots

    frequency, measured = _measured_transfer(found, period)
    grid = np.geomspace(LOWEST, HIGHEST, 400)
    viscous = found.load.row[2] if found.load is not None else 0.0
    model = transfer(found.drive, float(viscous), grid)
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.06)
    # A phase of more than half a turn continues; measured ones lie near the model.
    continued = np.degrees(np.unwrap(np.angle(model)))
    near = np.interp(frequency, grid, continued)
    off = np.degrees(np.angle(measured)) - near
    phases = near + (off + 180.0) % 360.0 - 180.0, continued
    for row, both in ((1, (np.abs(measured), np.abs(model))), (2, phases)):
        figure.add_scatter(
            x=frequency,
            y=both[0],
            mode='markers',
            name='measured',
            marker={'color': html.BLUE, 'size': 5},
            showlegend=row == 1,
            row=row,
            col=1,
        )
        figure.add_scatter(
            x=grid,
            y=both[1],
            mode='lines',
            name='modelled, linear part',
            line={'color': html.ORANGE},
            showlegend=row == 1,
            row=row,
            col=1,
        )
    figure.update_xaxes(type='log')
    figure.update_xaxes(title_text='frequency [Hz]', row=2, col=1)
    figure.update_yaxes(type='log', title_text='|X/R|', row=1, col=1)
    figure.update_yaxes(title_text='phase [deg]', row=2, col=1)
    return html.laid_out(figure, 420)


def value_text(value: float, half_width: float) -> str:
    if half_width == np.inf:
        return f'{value:.4g} unchanged, because these runs do not show it'
    return f'{value:.4g}' + (f' +- {half_width:.2g}' if np.isfinite(half_width) else '')


def time_rows(
    runs: Sequence[TracedRun], found: Fitted
) -> Iterator[tuple[str, str, str, str, str]]:
    """Yield trace, lines, measured and planned time of the motion between two functions."""
    for run, motion in zip(runs, found.motions, strict=True):
        measured, planned = run.measured, run.planned(motion)
        for first, last in run.stretches():
            lines = run.trace.line[[run.windows[first, 0], run.windows[last, 1]]]
            both = measured[first : last + 1].sum(), planned[first : last + 1].sum()
            yield (
                run.trace.name,
                f'{lines[0]} to {lines[1]}',
                f'{both[0]:.2f}',
                f'{both[1]:.2f}',
                f'{both[1] / both[0] - 1.0:+.2%}',
            )


def fitted_text(content: Mapping[str, Any], found: Fitted, names: Sequence[str]) -> str:
    """Return the text of a machine file with the fitted values, and intervals as comments."""
    whole: dict[str, Any] = dict(content)
    for key, (value, width) in found.values.items():
        if width == np.inf and key.startswith('limits'):
            continue  # the runs do not show it
        *path, last = key.split('.')
        place = whole
        for part in path:
            place[part] = dict(place.get(part) or {})
            place = place[part]
        place[last] = float(f'{value:.6g}')
    assert found.machine.pace is not None
    whole['look_ahead'][STOPS] = found.machine.pace.stops_at_rapids
    told = [f'#   {key}: {value_text(*pair)}' for key, pair in found.values.items()]
    head = [f'# Fitted to {", ".join(names)}; intervals of 95 %:', *told]
    return '\n'.join([*head, yaml.safe_dump(whole, sort_keys=False, default_flow_style=None)])


def write_fitted(runs: Sequence[TracedRun], found: Fitted, out: Path) -> None:
    values = [(escape(key), value_text(*pair)) for key, pair in found.values.items()]
    heads = 'record', 'lines', 'measured, s', 'planned, s', 'off'
    tables = html.table(('key of the machine file', 'value'), values) + html.table(
        heads, ([escape(cell) for cell in row] for row in time_rows(runs, found))
    )
    text = 'Values with intervals of 95 %, and times of the motion between two functions.'
    sections = [html.section('Fit', text, f'<div class="pair">{tables}</div>')]
    for run, motion in zip(runs, found.motions, strict=True):
        sections.append(
            html.section(
                escape(run.trace.name),
                'Feed recorded by the control and feed of the plan, aligned at each stretch.',
                html.drawing(_feeds(run, motion)),
            )
        )
    title = 'Run times of a machine'
    html.write(out, title, f'<h1>{title}</h1>' + ''.join(sections))


def _feeds(run: TracedRun, motion: Any) -> Any:
    from plotly.subplots import make_subplots

    figure = make_subplots(rows=1, cols=1)
    told = run.trace.feed
    kept = extremes(told[:, 1], html.BUCKETS) if len(told) else np.zeros(0, dtype=int)
    measured = {'color': html.BLUE, 'width': 1.2}
    time, feed = told[kept, 0], told[kept, 1] / MM_PER_MIN
    if len(told):  # records of cycle times have no feeds
        html.add_curve(figure, 1, time, feed, 'measured', measured, mode='lines')
    end = np.cumsum(motion.duration)
    for number, (first, last) in enumerate(run.stretches()):
        events = run.windows[first, 0], run.windows[last, 1]
        begin, finish = motion.until(run.trace.line[list(events)])
        rows = np.flatnonzero((end > begin) & (end <= finish))
        if not len(rows):
            continue
        rows = rows[extremes(motion.speed[rows], html.BUCKETS)]
        html.add_curve(
            figure,
            1,
            end[rows] - motion.duration[rows] - begin + run.trace.time[events[0]],
            motion.speed[rows] / MM_PER_MIN,
            'planned',
            {'color': html.ORANGE, 'width': 1.2, 'dash': 'dot'},
            number == 0,
            mode='lines',
        )
    return html.laid_out(figure, 420, xaxis_title='time [s]', yaxis_title='feed [mm/min]')
