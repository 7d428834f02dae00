"""Names of runs, of their second starts after a loss, and of their plans."""

from __future__ import annotations

#: Separate a run from how often it was begun again, and from the number of a plan.
GOES_ON, PLAN = '+', '#'


def same_run(program_id: str, other: str) -> bool:
    """Tell whether one run is the other, or goes on with it after a loss (``RUN+1``)."""
    return program_id.partition(GOES_ON)[0] == other.partition(GOES_ON)[0]


def goes_on(program_id: str, other: str) -> bool:
    """Tell whether a run is another one that was begun again after a loss."""
    run, _, times = program_id.partition(GOES_ON)
    other_run, _, other_times = other.partition(PLAN)[0].partition(GOES_ON)
    return run == other_run and times.isdigit() and int(times) > int(other_times or 0)
