"""Quality of service of every topic; those of ``run_program`` are rclpy's for actions."""

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
    return _last(DEPTH, profile.reliability, profile.durability)


#: ``blocks``, ``block_batches``, ``segments``: deeper than any window, so nothing is overwritten.
#: ``executed_setpoints``, ``axis_feedback``, ``followed_spindle``: the record
#: of a run must be complete.
STREAM = _last(DEPTH)
#: ``setpoints``: 5 s with chunks of 5 ms; a stop tail may have 100 kB, and a slow recorder keeps
#: all of them in memory.
SETPOINTS = _last(1024)
STATUS = _last(64)  #: ``stream_status``: an acknowledgement supersedes the one before.
STATE = _last(64)  #: ``machine_state``: changes of state must arrive.
MARKERS = _last(16)  #: ``markers``: profile of RViz; all is sent again to a new subscriber.
#: ``blocks``, ``block_batches``, ``executed_setpoints`` for viewers: no sender waits for them.
LISTENING = _last(DEPTH, BEST_EFFORT)
JOINTS = _last(10)  #: ``joint_states``: profile of RViz and recorders.
TRAJECTORY = _last(1)  #: Trajectories of ``drives: trajectory``: each replaces the one before.
#: Controller feedback: compatible with every publisher of joint states.
FEEDBACK = _last(64, BEST_EFFORT)
DIAGNOSTICS = _last(64)  #: ``/diagnostics``: profile of aggregators.
#: ``loaded_program``, ``setup_table``, ``modal_state``, ``active_modes``: kept for later
#: subscribers.
LOADED = _last(1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
CONTACTS = _last(64)  #: ``probe_contact``: every one must arrive.
OVERRIDE = _last(10)  #: Overrides: profile of ``ros2 topic pub``.
BEATS = _last(1, BEST_EFFORT)  #: ``jog``: a lost beat must not be resent.
