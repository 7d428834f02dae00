"""What the planning of a run is doing: one table of activities, and the end of the path."""

from __future__ import annotations

from enum import Enum, IntEnum


class Activity(Enum):
    """What the planning of a run is doing."""

    NONE = 'no run'
    WAITING = 'waits for the machine to rest'
    PLANNING = 'plans ahead'
    REVISING = 'plans with other settings; the old plan goes on'
    JOINING = 'has sent a plan that joins the one before'
    RESUMING = 'plans anew from rest'
    ENDED = 'the run is over'


class Step(Enum):
    """What changes the activity."""

    BEGIN = 'the first segment of a run came'
    PLACE = 'the machine told where it rests'
    REVISE = 'the operator changed a setting'
    JOIN = 'the plan with other settings is in time'
    RESUME = 'the machine left the plan and rests'
    DONE = 'the plan is there'
    END = 'the run was executed, refused or given up'


A, S = Activity, Step
TABLE: dict[tuple[Activity, Step], Activity] = {
    (A.WAITING, S.PLACE): A.PLANNING,
    (A.PLANNING, S.REVISE): A.REVISING,
    (A.REVISING, S.DONE): A.PLANNING,
    (A.REVISING, S.JOIN): A.JOINING,
    (A.JOINING, S.DONE): A.PLANNING,
    (A.PLANNING, S.RESUME): A.RESUMING,
    (A.RESUMING, S.DONE): A.PLANNING,
    **{(activity, S.BEGIN): A.WAITING for activity in A},
    **{(activity, S.END): A.ENDED for activity in A if activity is not A.NONE},
}


class PathEnd(IntEnum):
    """How far the end of the path has got through planning."""

    OPEN = 0  # further segments come
    KNOWN = 1  # the last segment is there
    PLANNED = 2  # it is planned, down to rest
    QUEUED = 3  # its last setpoint is handed to the sender
