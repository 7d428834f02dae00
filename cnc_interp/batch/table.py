"""The table of a batch: CSV for everybody, Parquet for programs; what it cost stands apart."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cnc_interp.batch.task import BatchEntry, TaskOutcome
from cnc_interp.core.small_files import write_whole
from cnc_interp.core.units import HOUR

Results = Sequence[tuple[BatchEntry, TaskOutcome]]
#: Columns of the table: name with its unit, and type. All but the first two and ``cost`` are
#: fields of ``Row``.
COLUMNS = {
    'program': str, 'machine': str, 'verdict': str, 'message': str, 'blocks': int,
    'setpoints': int, 'path_length_m': float, 'cycle_time_s': float, 'time_bound_s': float,
    'cost': float, 'velocity_use': float, 'acceleration_use': float, 'jerk_use': float,
    'torque_use': float, 'contour_used': float, 'orientation_used': float, 'notices': str,
    'plan_hash': str,
}  # fmt: skip
#: Columns whose field of ``Row`` has another name.
FIELDS = {
    'path_length_m': 'path_length', 'cycle_time_s': 'cycle_time', 'time_bound_s': 'time_bound',
}  # fmt: skip
COSTS = ('program', 'machine', 'seconds', 'processor_s', 'memory_MB')


def rows_of(results: Results, rate: float | None) -> list[dict[str, Any]]:
    return [_row(job, outcome, rate) for job, outcome in results]


def _row(job: BatchEntry, outcome: TaskOutcome, rate: float | None) -> dict[str, Any]:
    row = outcome.row
    own = {
        'program': job.program,
        'machine': job.model.name,
        'verdict': str(row.verdict),
        'notices': '; '.join(row.notices),
        'cost': rate * row.cycle_time / HOUR if rate and row.cycle_time else None,
    }
    return {name: own[name] if name in own else getattr(row, FIELDS.get(name, name))
            for name in COLUMNS}  # fmt: skip


def write_tables(results: Results, rate: float | None, folder: Path) -> list[Path]:
    """Write ``table.csv``, ``costs.csv`` and, with pyarrow, ``table.parquet``; return them."""
    rows = rows_of(results, rate)
    table, costs = folder / 'table.csv', folder / 'costs.csv'
    write_whole(table, _csv(tuple(COLUMNS), [list(row.values()) for row in rows]))
    write_whole(costs, _csv(COSTS, [_cost(job, outcome) for job, outcome in results]))
    return [table, *_parquet(rows, folder / 'table.parquet'), costs]


def _cost(job: BatchEntry, outcome: TaskOutcome) -> list[object]:
    cost = outcome.cost
    return [job.program, job.model.name, f'{cost.seconds:.3f}', f'{cost.processor:.3f}',
            f'{cost.memory / 1e6:.0f}']  # fmt: skip


def _csv(names: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return rows as CSV; numbers are exact, None is empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator='\n')
    writer.writerow(names)
    writer.writerows(rows)
    return text.getvalue()


def _parquet(rows: list[dict[str, Any]], file: Path) -> list[Path]:
    """Write Parquet; return its path, if pyarrow is installed."""
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        return []
    kinds = {str: pyarrow.string(), int: pyarrow.int64(), float: pyarrow.float64()}
    schema = pyarrow.schema([(name, kinds[kind]) for name, kind in COLUMNS.items()])
    parquet.write_table(pyarrow.Table.from_pylist(rows, schema=schema), file)
    return [file]
