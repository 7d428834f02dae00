"""Parts of the HTML page: its style, its sections and the drawings in them."""

from __future__ import annotations

from typing import Any

STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0; background: #f4f6f8; color: #22303c;
  font: 14px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, Arial, sans-serif; }
main { max-width: 1240px; margin: 0 auto; padding: 28px 24px 48px; }
h1 { font-size: 22px; font-weight: 600; margin: 0; }
h1 + p { margin: 2px 0 20px; color: #5c6b78; }
h2 { font-size: 15px; font-weight: 600; margin: 0 0 2px; }
section { background: white; border: 1px solid #e1e6ea; border-radius: 6px;
  padding: 16px 18px 8px; margin-top: 16px; }
section > p { margin: 0 0 6px; color: #5c6b78; }
.badge { font-size: 13px; font-weight: 600; border-radius: 4px; padding: 2px 10px;
  margin-left: 10px; vertical-align: 3px; color: white; background: #2e7d4f; }
.badge.no { background: #c0392b; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(206px, 1fr)); gap: 12px; }
.tile { background: white; border: 1px solid #e1e6ea; border-radius: 6px; padding: 10px 14px; }
.tile b { display: block; font-size: 20px; font-weight: 600; white-space: nowrap; }
.tile span { color: #5c6b78; font-size: 12.5px; }
.faults { border-color: #c0392b; }
.faults li { margin-bottom: 4px; }
select { font: inherit; color: inherit; max-width: 100%; padding: 4px 8px; margin: 2px 0 8px;
  border: 1px solid #c3cad1; border-radius: 4px; background: white; }
.pair { display: grid; grid-template-columns: minmax(0, 1fr) minmax(0, 1fr); gap: 12px; }
@media (max-width: 860px) { .pair { grid-template-columns: minmax(0, 1fr); } }
.wide { overflow-x: auto; margin-bottom: 10px; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; width: 100%; }
.uses td:nth-child(odd) { font-weight: 600; padding-right: 18px; }
th, td { padding: 3px 14px 3px 0; border-bottom: 1px solid #e6eaee; text-align: right; }
th { font-weight: 600; } tbody th { font-weight: 400; }
th:first-child { text-align: left; color: #5c6b78; }
footer { color: #7b8794; font-size: 12.5px; margin-top: 18px; }
"""

#: Part programs are confidential: no button may upload a figure.
CONTROLS = {
    'displaylogo': False,
    'responsive': True,
    'showSendToCloud': False,
    'modeBarButtonsToRemove': ['sendChartToCloud', 'sendDataToCloud'],
}


def section(heading: str, text: str, content: str) -> str:
    """
    Write a section with a heading.

    Parameters
    ----------
    heading, text, content : str
        HTML of the heading, of the text below it and of the content.

    Returns
    -------
    str
        HTML.

    """
    return f'<section><h2>{heading}</h2><p>{text}</p>{content}</section>'


def drawing(figure: Any) -> str:
    """Write a plotly figure as HTML; the page must contain plotly.js."""
    drawing: str = figure.to_html(
        full_html=False, include_plotlyjs=False, default_width='100%', config=CONTROLS
    )
    return drawing
