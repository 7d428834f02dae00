"""The least time beside the law: how near it is, and what it costs of planning; run by itself."""

from __future__ import annotations

import sys
import time
from itertools import chain

from paths import Case, cases, dense_cases

from cnc_interp.feedrate.plan_options import PlanOptions
from cnc_interp.feedrate.window import PlannedPiece, plan_path
from cnc_interp.kinematics.machine import Machine
from cnc_interp.settings.choices import DEFAULT_MACHINE

#: How often each path is planned; the shortest time counts.
TIMES = 5


def fastest(case: Case, bound: bool) -> tuple[float, PlannedPiece]:
    """Return the CPU time of planning a path [s], and the plan."""
    seconds = []
    for _ in range(TIMES):
        begun = time.process_time()
        piece = plan_path(case.path, case.limits, PlanOptions(bound=bound))
        seconds.append(time.process_time() - begun)
    return min(seconds), piece


def main() -> int:
    """Print one line for each path."""
    heads = 'cells', 'law s', 'bound s', 'law/bound', 'its share'
    print(f'{"path":<42}' + ''.join(f'{head:>10}' for head in heads))
    alone = both = 0.0
    for case in chain(cases(), dense_cases(Machine.load(DEFAULT_MACHINE))):
        without, _ = fastest(case, False)
        seconds, piece = fastest(case, True)
        alone, both = alone + without, both + seconds
        least, law = piece.least_time, piece.law
        print(
            f'{case.name:<42}{len(law):>10}{law.end_time:>10.4f}{least:>10.4f}'
            f'{law.end_time / least:>10.3f}{1 - without / seconds:>10.1%}',
            flush=True,
        )
    print(f'share of the feed planner in all: {1 - alone / both:.1%}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
