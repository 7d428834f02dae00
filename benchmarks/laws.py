"""VPOp beside our law: cycle times, toppra's bound, exact stops; run by itself."""

from __future__ import annotations

import statistics
import sys
import time

from active import largest_use
from paths import cases, stop_at_corners

from cnc_interp.core import PlanningError
from cnc_interp.feedrate.plan_options import PlanOptions
from cnc_interp.feedrate.planning_windows import plan_path


def main() -> int:
    """Print one line for each path."""
    heads = 'ours s', 'vpop s', 'ratio', 'bound s', 'stops s', 'use', 'solved', 'plan s'
    print(f'{"path":<34}' + ''.join(f'{head:>10}' for head in heads))
    ratios = []
    for case in cases():
        ours = plan_path(case.path, case.limits)
        begun = time.process_time()
        try:
            vpop = plan_path(case.path, case.limits, PlanOptions(law='vpop'))
        except PlanningError as error:
            print(f'{case.name:<34} {error}', flush=True)
            continue
        seconds = time.process_time() - begun
        ratios.append(vpop.law.end_time / ours.law.end_time)
        print(
            f'{case.name:<34}{ours.law.end_time:>10.4f}{vpop.law.end_time:>10.4f}'
            f'{ratios[-1]:>10.4f}{ours.least_time:>10.4f}{stop_at_corners(case):>10.4f}'
            f'{largest_use(vpop, case.limits):>10.4f}{vpop.solved:>10}{seconds:>10.2f}',
            flush=True,
        )
    print(f'vpop / ours: median {statistics.median(ratios):.4f}, largest {max(ratios):.4f}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
