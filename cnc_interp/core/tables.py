"""Tables: columns with one row per element, each declared once at its field.

A field declares everything about a column: ``column`` gives the shape of a row and the default,
the annotation gives the dtype, and the comment gives the meaning and the unit. Slices, joins,
shape checks, files and messages are derived from these declarations.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, Self, dataclass_transform

import numpy as np
from numpy.typing import NDArray

from cnc_interp.core import BoolArray, IntArray

#: Dtypes by the annotation of the field.
KINDS = {'FloatArray': np.float64, 'IntArray': np.int64, 'BoolArray': np.bool_}


@dataclass(frozen=True)
class Column:
    """The declaration of one column."""

    tail: tuple[int | str, ...] = ()  #: Shape of a row; a name means any size.
    kind: type[Any] = np.float64  #: Dtype.
    default: Any = None  #: Value of all rows if the column is left out; None: required.
    in_plans: bool = True  #: Whether plan files contain it.

    def filled(self, rows: int) -> NDArray[Any]:
        """Return the column filled with its default; dimensions of any size get size 0."""
        tail = (0 if isinstance(count, str) else count for count in self.tail)
        return np.full((rows, *tail), self.default or 0, self.kind)

    def fits(self, shape: tuple[int, ...], rows: int) -> bool:
        """Return whether ``shape`` is that of this column with ``rows`` rows."""
        if len(shape) != 1 + len(self.tail) or shape[0] != rows:
            return False
        return shape[1:] == self.tail or all(
            isinstance(count, str) or count == found
            for count, found in zip(self.tail, shape[1:], strict=True)
        )

    def shape_text(self, rows: int) -> str:
        return f'({", ".join(map(str, (rows, *self.tail)))}{"" if self.tail else ","})'


def column(*tail: int | str, default: Any = None, in_plans: bool = True) -> Any:
    """Declare a column at its field; ``tail``: shape of a row, with a name for any size."""
    optional: dict[str, Any] = {} if default is None else {'default': None}
    return field(**optional, metadata={'tail': tail, 'default': default, 'in_plans': in_plans})


@dataclass_transform(frozen_default=True, field_specifiers=(column,))
class Table:
    """Base of tables: a frozen dataclass of equally long, read-only columns or tables."""

    declared: ClassVar[Mapping[str, Column]]  #: The columns by name, in order.
    _names: ClassVar[tuple[str, ...]]  # of all fields

    def __init_subclass__(cls) -> None:
        dataclass(frozen=True)(cls)
        found = fields(cls)  # type: ignore[arg-type]
        cls._names = tuple(f.name for f in found)
        cls.declared = {
            f.name: Column(kind=KINDS[str(f.type)], **f.metadata) for f in found if f.metadata
        }

    def __post_init__(self) -> None:
        rows, columns = len(self), self.__dict__
        for name, declared in self.declared.items():
            values = columns[name]
            if values is None:
                columns[name] = values = declared.filled(rows)
            elif not declared.fits(values.shape, rows):
                raise ValueError(
                    f'column {name} has shape {values.shape}, expected {declared.shape_text(rows)}'
                )
            values.flags.writeable = False

    def __len__(self) -> int:
        return len(self.__dict__[self._names[0]])

    def __getitem__(self, rows: slice | IntArray | BoolArray) -> Self:
        columns = self.__dict__
        return self._of({name: columns[name][rows] for name in self._names})

    def having(self, **columns: Any) -> Self:
        """Return these rows with other columns, without checking their shapes."""
        return self._of({**self.__dict__, **columns})

    @classmethod
    def _of(cls, columns: Mapping[str, Any]) -> Self:
        """Return a table of columns without checking their shapes."""
        made = object.__new__(cls)
        made.__dict__.update(columns)
        for name in cls.declared:
            columns[name].flags.writeable = False
        return made

    def columns(self) -> dict[str, NDArray[Any]]:
        return {name: getattr(self, name) for name in self.declared}

    @classmethod
    def of_columns(cls, columns: Mapping[str, NDArray[Any]]) -> Self:
        """Return a table from columns by name, as in an archive; KeyError if one is missing."""
        return cls(
            **{
                name: columns[name]
                for name, declared in cls.declared.items()
                if declared.default is None or name in columns
            }
        )

    @classmethod
    def none(cls) -> Self:
        return cls(**{name: declared.filled(0) for name, declared in cls.declared.items()})

    @classmethod
    def concatenate(cls, parts: Iterable[Self]) -> Self:
        """Join tables in order; those without rows may have columns of any width."""
        parts = list(parts)
        full = [part for part in parts if len(part)] or parts[:1]
        if len(full) == 1:
            return full[0]
        return cls._of(
            {name: _joined([part.__dict__[name] for part in full]) for name in cls._names}
        )


def _joined(parts: list[Any]) -> Any:
    if isinstance(parts[0], Table):
        return type(parts[0]).concatenate(parts)
    return np.concatenate(parts)
