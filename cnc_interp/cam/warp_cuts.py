"""The loops of ``needle_cuts.py``, run by Warp in double precision; heights agree to 1e-11 m."""

import ast
import inspect
import linecache
import textwrap
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np

from cnc_interp.cam import needle_cuts
from cnc_interp.cam.needles import MotionPieces
from cnc_interp.core import FloatArray, InterpError

#: Functions that are translated, in the order of their calls.
FUNCTIONS = ('gap', 'entry', 'entry_at', 'lowest', 'cut_roughly', 'cut_finely')
CONSTANTS = ('DEPTH', 'TOP', 'SHORT')  #: Module constants that they use.
#: Types of their arguments.
TYPES = {'float': 'wp.float64', 'int': 'wp.int32', 'FloatArray': 'wp.array2d(dtype=wp.float64)'}
#: One thread: a needle and all pieces; ``cut_roughly`` and ``cut_finely`` take them in batches.
KERNEL = """
def cut_needle(
    needle: wp.array2d(dtype=wp.float64), first: wp.array2d(dtype=wp.float64),
    middle: wp.array2d(dtype=wp.float64), last: wp.array2d(dtype=wp.float64),
    slack: wp.array(dtype=wp.float64), rough: wp.array(dtype=wp.int32),
    end: wp.array(dtype=wp.int32), stages: wp.int32, widest: wp.float64, R: wp.float64,
    skin: wp.float64, height: wp.array(dtype=wp.float64),
):
    j = wp.tid()
    most = height[j]
    begin = wp.int32(0)
    for batch in range(end.shape[0]):
        for p in range(begin, end[batch]):
            if rough[p] != 0:
                most = cut_roughly(needle, j, most, middle, p, R, skin)
        for p in range(begin, end[batch]):
            most = cut_finely(
                needle, j, most, first, middle, last, slack[p], p, stages, widest, R, skin
            )
        begin = end[batch]
    height[j] = most
"""


def warp(device: str) -> ModuleType:
    try:
        import warp as wp
    except ModuleNotFoundError:
        raise InterpError(
            f'--device {device} needs Warp: pip install warp-lang (0.4 GB), or take --device cpu'
        ) from None
    wp.config.log_level = wp.LOG_ERROR
    if device == 'cuda' and not wp.is_cuda_available():
        raise InterpError('--device cuda: no CUDA device here; take --device cpu')
    found: ModuleType = wp
    return found


def cut_by_warp(needle: FloatArray, sweep: MotionPieces, device: str) -> FloatArray:
    wp = warp(device)
    place = 'cpu' if device == 'warp-cpu' else 'cuda'

    def there(values: Any, kind: Any) -> Any:
        return wp.array(np.ascontiguousarray(values), dtype=kind, device=place)

    end = np.flatnonzero(np.diff(sweep.batch, append=-1)) + 1
    height = there(np.full(len(needle), needle_cuts.TOP), wp.float64)
    stages, widest = sweep.search
    poses = (there(poses, wp.float64) for poses in (sweep.first, sweep.middle, sweep.last))
    wp.launch(
        _kernel(),
        len(needle),
        device=place,
        inputs=[
            there(needle, wp.float64),
            *poses,
            there(sweep.slack, wp.float64),
            there(sweep.rough.astype(np.int32), wp.int32),
            there(end.astype(np.int32), wp.int32),
            stages,
            widest,
            sweep.cutter.tool_radius,
            sweep.skin,
            height,
        ],
    )
    return np.asarray(height.numpy())


@cache
def _kernel() -> Any:
    import warp as wp

    names: dict[str, Any] = {'wp': wp, 'sqrt': wp.sqrt, 'min': wp.min, 'max': wp.max}
    names['__name__'] = 'cnc_interp_needles'
    for name in CONSTANTS:
        names[name] = wp.constant(wp.float64(getattr(needle_cuts, name)))
    module = wp.get_module(names['__name__'])
    module.options |= {'fuse_fp': False, 'fast_math': False, 'enable_backward': False}
    for name in FUNCTIONS:
        plain = getattr(needle_cuts, name).py_func
        names[name] = wp.func(_compiled(name, translated(plain), names), module=module)
    return wp.kernel(_compiled('cut_needle', KERNEL, names), module=module)


def translated(function: Any) -> str:
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    (definition,) = tree.body
    assert isinstance(definition, ast.FunctionDef)
    definition.decorator_list, definition.returns = [], None
    for argument in definition.args.args:
        assert isinstance(argument.annotation, ast.Name)
        argument.annotation = ast.parse(TYPES[argument.annotation.id], mode='eval').body
    return ast.unparse(ast.fix_missing_locations(_Doubles().visit(tree)))


class _Doubles(ast.NodeTransformer):
    """Gives literals double precision, because Warp assumes single; drops types of variables."""

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        assert node.value is not None
        return self.generic_visit(ast.copy_location(ast.Assign([node.target], node.value), node))

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        if not isinstance(node.value, float):
            return node
        return ast.parse(f'wp.float64({node.value!r})', mode='eval').body


def _compiled(name: str, text: str, names: dict[str, Any]) -> Any:
    """Return the function of a text, which Warp reads again with ``inspect``."""
    file = f'<{name} for Warp>'
    linecache.cache[file] = (len(text), None, text.splitlines(keepends=True), file)
    exec(compile(text, file, 'exec'), names)
    return names[name]
