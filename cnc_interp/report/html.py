"""Self-contained HTML pages: their style, sections and drawings, and the packed library."""

import json
import re
import zlib
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from cnc_interp.core import FloatArray
from cnc_interp.core.small_files import write_whole

BESIDE = Path(__file__).parent  #: Folder of the texts of the pages.
STYLE = BESIDE.joinpath('style.css').read_text(encoding='utf-8')

#: Options of figures; part programs are confidential, so no button may upload a figure.
CONTROLS = json.dumps(
    {
        'displaylogo': False,
        'responsive': True,
        'showSendToCloud': False,
        'modeBarButtonsToRemove': ['sendChartToCloud', 'sendDataToCloud'],
    }
)


def section(heading: str, text: str, content: str) -> str:
    return f'<section><h2>{heading}</h2><p>{text}</p>{content}</section>'


def table(heads: Iterable[str], rows: Iterable[Sequence[str]], span: int = 1) -> str:
    """Write a table of HTML texts; headings except the first span ``span`` columns."""
    first, *others = heads
    wide = f' colspan="{span}"' if span > 1 else ''
    head = f'<th>{first}</th>' + ''.join(f'<th{wide}>{text}</th>' for text in others)
    lines = (''.join([f'<th>{row[0]}</th>', *(f'<td>{x}</td>' for x in row[1:])]) for row in rows)
    body = f'<tbody>{"".join(f"<tr>{line}</tr>" for line in lines)}</tbody>'
    return f'<div class="wide"><table><thead><tr>{head}</tr></thead>{body}</table></div>'


def tiles(rows: Iterable[tuple[str, str]]) -> str:
    cells = (f'<div class="tile"><b>{x}</b><span>{label}</span></div>' for x, label in rows)
    return f'<div class="tiles">{"".join(cells)}</div>'


def drawing(figure: Any) -> str:
    return f'<div class="figure">{packed(figure.to_json())}</div>'


def packed(text: str, name: str = '') -> str:
    return f'<script type="application/json" id="{name}">{text}</script>'


PACKED = re.compile(r'(<script type="application/json" id="[^"]*">)(.*?)</script>', re.S)
#: Unpacks the library and the JSON texts, and draws; ``window.drawMore`` draws the rest.
UNPACK = BESIDE.joinpath('unpack.js').read_text(encoding='utf-8')


def letters(whole: bytes) -> str:
    """Encode bytes as 7-bit characters, avoiding those that HTML would change or end at."""
    bits = np.unpackbits(np.frombuffer(whole, dtype=np.uint8))
    sevens = np.pad(bits, (0, -len(bits) % 7)).reshape(-1, 7)
    plain = (np.packbits(sevens, axis=1) >> 1).tobytes().decode('ascii')
    return plain.translate({ord(letter): ord(letter) + 256 for letter in '\0\r<'})


def document(title: str, body: str, style: str = '') -> str:
    """Return a page that needs no network, its figures compressed."""
    from plotly.offline import get_plotlyjs

    texts = [get_plotlyjs()]

    def take(found: re.Match[str]) -> str:
        texts.append(found[2])
        return f'{found[1]}</script>'

    body = PACKED.sub(take, body)
    whole = zlib.compress('\0'.join(texts).encode(), 9)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<title>{escape(title)}</title><style>{STYLE}{style}</style></head>'
        f'<body><main>{body}</main><script type="text/plain" id="packed" '
        f'data-size="{len(whole)}">{letters(whole)}</script>'
        f'<script>{UNPACK.replace("CONTROLS", CONTROLS)}</script></body></html>\n'
    )


def write(file: Path, title: str, body: str, style: str = '') -> None:
    """Write a page that needs no network."""
    file.parent.mkdir(parents=True, exist_ok=True)
    write_whole(file, document(title, body, style))


INK, GRID = '#22303c', '#e6eaee'
BLUE, ORANGE, RED = '#1f6fb2', '#e08a1e', '#c0392b'
FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif'
BUCKETS = 600  #: Buckets of thinned curves over the whole width; each keeps its extremes.
#: Largest ratio of the upper end of a feed axis to the feed, because Eq. 10 is infinite on lines.
HEADROOM = 1.45
#: Hover text of a feed; its custom data are time, way and line.
AT_PLACE = (
    '%{y:.0f} mm/min at %{customdata[0]:.3f} s, %{customdata[1]:.2f} mm, line %{customdata[2]:.0f}'
)


def base_layout(height: int) -> dict[str, Any]:
    return {
        'height': height,
        'template': 'none',
        'font': {'family': FONT, 'size': 12, 'color': INK},
        'paper_bgcolor': 'white',
        'plot_bgcolor': 'white',
        'margin': {'l': 70, 'r': 16, 't': 34, 'b': 46},
        'legend': {'orientation': 'h', 'x': 0.0, 'y': 1.0, 'yanchor': 'bottom'},
        'hovermode': 'x',
        'hoverlabel': {'font': {'family': FONT, 'size': 12}},
    }


def laid_out(figure: Any, height: int, **own: Any) -> Any:
    """Give a flat figure the common layout and axes, and its own settings."""
    figure.update_layout(base_layout(height), **own)
    quiet = {'gridcolor': GRID, 'zerolinecolor': '#c3cad1', 'linecolor': '#c3cad1'}
    figure.update_xaxes(**quiet, ticks='outside', tickcolor='#c3cad1', title_standoff=6)
    figure.update_yaxes(**quiet, title_standoff=8)
    return figure


def add_curve(
    figure: Any,
    row: int,
    x: FloatArray,
    y: FloatArray,
    name: str,
    line: Any,
    shown: bool = True,
    **more: Any,
) -> None:
    figure.add_scatter(
        x=rounded(x), y=rounded(y), name=name, line=line, showlegend=shown, row=row, col=1, **more
    )


def scene(ranges: Iterable[dict[str, Any]], eye: dict[str, float], low: float) -> dict[str, Any]:
    """Return axes and camera of a figure in space; the view centre is moved down by ``low``."""
    plain = {'backgroundcolor': 'white', 'gridcolor': GRID, 'zerolinecolor': GRID}
    return {
        **{
            f'{c}axis': {**plain, 'title': {'text': f'{c} (mm)'}, **own}
            for c, own in zip('xyz', ranges, strict=True)
        },
        'camera': {'eye': eye, 'center': {'x': 0.0, 'y': 0.0, 'z': -low}},
    }


def feed_ceiling(feed: FloatArray, programmed: FloatArray, most: float = 3.0) -> float:
    """Choose the upper end of a feed axis, at most ``most`` times above the fastest motion."""
    asked = float(programmed[np.isfinite(programmed)].max(initial=0.0))
    fastest = float(feed.max(initial=0.0))
    return HEADROOM * max(fastest, min(asked, most * fastest)) or 1.0


def xyz(points: FloatArray) -> dict[str, Any]:
    return {name: rounded(column) for name, column in zip('xyz', points.T, strict=True)}


def rounded(values: FloatArray) -> Any:
    """Return values, or columns of them, as lists rounded to the resolution of a screen."""
    columns = np.atleast_2d(values.T)
    spread = np.ptp(np.where(np.isfinite(columns), columns, 0.0), axis=1)
    digits = np.clip(np.ceil(5.0 - np.log10(np.maximum(spread, 1e-9))), 0, 9).astype(int)
    kept = [np.round(column, most) for column, most in zip(columns, digits, strict=True)]
    return np.stack(kept, axis=-1).reshape(values.shape).tolist()
