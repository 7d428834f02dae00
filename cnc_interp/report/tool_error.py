"""The section about what the drives leave of the motion at the tool."""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from cnc_interp.core.units import ARCSEC, UM
from cnc_interp.drives.tool_error import ToolError, tool_error
from cnc_interp.machine_model.machine import Machine
from cnc_interp.proof.plan_files import PlanFiles
from cnc_interp.report.html import drawing, section
from cnc_interp.report.plot_style import BLUE, BUCKETS, ORANGE, base_layout, rounded, with_axes
from cnc_interp.report.series import extremes


def tool_error_section(plan: PlanFiles, machine: Machine) -> str:
    """Draw the errors of the simulated drives at the tool, with and without compensation."""
    velocity = np.asarray(plan.setpoints['velocity'])
    position = np.asarray(plan.position)
    plain, compensated = (
        tool_error(machine, plan.period, position, velocity, model) for model in (None, machine)
    )
    return section(
        'Error at the tool',
        'By the drives of the machine file: the tip from the commanded path, and the tool axis '
        f'from the commanded one. As they are: {_largest(plain)}. '
        f'Compensated: {_largest(compensated)}.',
        drawing(_figure(plain, compensated, plan.period)),
    )


def _largest(error: ToolError) -> str:
    tip, axis = error.tip / UM, error.axis / ARCSEC
    return (
        f'tip {tip.max():.1f} &#181;m at most, {tip.mean():.2f} &#181;m in the mean, '
        f'axis {axis.max():.1f}&Prime; at most, {axis.mean():.2f}&Prime; in the mean'
    )


def _figure(plain: ToolError, compensated: ToolError, period: float) -> Any:
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.06)
    for name, error, colour in (
        ('as they are', plain, ORANGE),
        ('compensated', compensated, BLUE),
    ):
        for row, curve in ((1, error.tip / UM), (2, error.axis / ARCSEC)):
            kept = extremes(curve, BUCKETS)
            figure.add_trace(
                go.Scattergl(
                    x=rounded(kept * period), y=rounded(curve[kept]), name=name, mode='lines',
                    line={'color': colour, 'width': 1.2}, showlegend=row == 1,
                ),
                row=row, col=1,
            )  # fmt: skip
    figure.update_layout(**base_layout(400))
    figure.update_xaxes(title_text='time [s]', row=2, col=1)
    figure.update_yaxes(title_text='tip [µm]', row=1, col=1)
    figure.update_yaxes(title_text='axis [arcsec]', row=2, col=1)
    return with_axes(figure)
