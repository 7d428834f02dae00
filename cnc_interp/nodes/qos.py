"""Quality of service of every topic, in one table.

| topic | reliability | durability | history | why |
|---|---|---|---|---|
| ``blocks``, ``block_batches``, ``segments`` | reliable | volatile | last 4096 | deeper than any window, so nothing is overwritten; nothing old is replayed |
| ``setpoints`` | reliable | volatile | last 1024 | 5 s with chunks of 5 ms; a stop tail may have 100 kB, and a slow recorder keeps all of them in memory |
| ``stream_status`` | reliable | volatile | last 64 | an acknowledgement supersedes the one before |
| ``machine_state`` | reliable | volatile | last 64 | changes of state must arrive |
| ``loaded_program`` | reliable | transient local | last 1 | for those who join during a run |
| ``setup_table`` | reliable | transient local | last 1 | for those who join later |
| ``modal_state``, ``active_modes`` | reliable | transient local | last 1 | for those who join later |
| ``joint_states`` | reliable | volatile | last 10 | what RViz and recorders ask for |
| ``executed_setpoints``, ``axis_feedback`` | reliable | volatile | last 4096 | the record of a run must be complete |
| ``feed_override``, ``rapid_override`` | reliable | volatile | last 10 | what ``ros2 topic pub`` offers; who starts late reads ``machine_state`` |
| ``jog`` | best effort | volatile | last 1 | a beat that is lost must not come late |
| trajectories of ``drives: trajectory`` | reliable | volatile | last 1 | each replaces the one before |
| its feedback | best effort | volatile | last 64 | fits every publisher of joint states |
| ``markers`` | reliable | volatile | last 16 | what RViz asks for; all are sent again to a new listener |
| ``blocks``, ``block_batches``, ``executed_setpoints`` for those who only look | best effort | volatile | last 4096 | no sender waits for a viewer |
| ``/diagnostics`` | reliable | volatile | last 64 | what aggregators ask for |
| ``run_program`` | rclpy's defaults for actions | | | |
"""  # noqa: E501

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

DEPTH = 4096  #: Largest window that a node may be given, in messages.


RELIABLE, BEST_EFFORT = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT


def _last(
    depth: int,
    reliability: ReliabilityPolicy = RELIABLE,
    durability: DurabilityPolicy = DurabilityPolicy.VOLATILE,
) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=reliability,
        durability=durability,
    )


def listening_to(profile: QoSProfile) -> QoSProfile:
    """Return the profile of a recorder: the offered one with a longer queue."""
    return _last(DEPTH, profile.reliability, profile.durability)


STREAM = _last(DEPTH)
SETPOINTS = _last(1024)
STATUS = _last(64)
STATE = _last(64)
MARKERS = _last(16)
LISTENING = _last(DEPTH, BEST_EFFORT)
JOINTS = _last(10)
TRAJECTORY = _last(1)
FEEDBACK = _last(64, BEST_EFFORT)
DIAGNOSTICS = _last(64)
LOADED = _last(1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
OVERRIDE = _last(10)
BEATS = _last(1, BEST_EFFORT)
