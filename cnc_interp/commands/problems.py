"""`cnc-interp problems`: the problem set as files, and scores of motions along its paths."""

from argparse import Namespace
from pathlib import Path
from typing import Any

from cnc_interp.commands.parser import FAILED, FINE, command
from cnc_interp.core import MS, UM, InterpError


def add_problems_command(commands: Any) -> None:
    problems = command(
        commands, 'problems', lambda options: (_score if options.score else _show)(options),
        'compare feed laws: forty paths with their optimum times, as files, and scores of motions',
        'cnc-interp problems --score out/motions',
    )  # fmt: skip
    problems.option('--write', 'write each path and its limits as .npz', Path, 'DIR')
    text = 'score motions: NAME.npz with position, or NAME.csv, a row each period'
    problems.option('--score', text, Path, 'DIR')
    problems.number('--period', 1.0, 'period of the motions', 'MS')


def _show(options: Namespace) -> int:
    import numpy as np

    from cnc_interp.problems import known, problems

    if options.write is not None:
        options.write.mkdir(parents=True, exist_ok=True)
    print(f'{"path":<28}{"optimum s":>11}{"ours s":>11}{"no jerk s":>11}')
    for case in problems():
        print(f'{case.name:<28}' + ''.join(f'{time:>11.4f}' for time in known(case.name)))
        if options.write is not None:
            names = 's', 'cell_left', 'cell_right', 'cell_feed', 'stop'
            columns = {name: getattr(case.path, name) for name in names}
            file = options.write / f'{case.name}.npz'
            np.savez_compressed(file, limits=case.limits.limits, **columns)
    return FINE


def _score(options: Namespace) -> int:
    import numpy as np

    from cnc_interp.problems import problem, score

    files = sorted([*options.score.glob('*.npz'), *options.score.glob('*.csv')])
    if not files:
        raise InterpError(f'{options.score}: has no NAME.npz or NAME.csv, NAME of a problem')
    kept = True
    print(f'{"path":<28}{"time s":>11}{"/ optimum":>11}{"use":>9}{"beside um":>11}')
    for file in files:
        try:
            csv = file.suffix == '.csv'
            q = np.loadtxt(file, delimiter=',') if csv else np.load(file)['position']
        except (ValueError, KeyError, OSError) as fault:
            raise InterpError(f'{file}: cannot be read: {fault}') from None
        found = score(problem(file.stem), q, options.period * MS)
        kept &= found.kept
        print(
            f'{found.name:<28}{found.time:>11.4f}{found.ratio:>11.4f}{found.use:>9.2%}'
            f'{found.deviation / UM:>11.3f}' + ('' if found.kept else '  NOT kept')
        )
    return FINE if kept else FAILED
