"""Quality of service of every topic; ``run_program`` has rclpy's defaults for actions."""

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

DEPTH = 4096  #: Largest window of a stream [messages].
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


#: ``blocks``, ``block_batches``, ``segments``: no window is larger, so no message is overwritten.
#: ``executed_setpoints``, ``axis_feedback``, ``followed_spindle``: a record must be complete.
STREAM = _last(DEPTH)
#: ``setpoints``: 5 s of chunks of 5 ms. It is not more, because a stop tail may have 100 kB and
#: a slow recorder keeps all messages in memory.
SETPOINTS = _last(1024)
STATUS = _last(64)  #: ``stream_status``: the latest acknowledgement replaces earlier ones.
STATE = _last(64)  #: ``machine_state``: every change of the state must arrive.
MARKERS = _last(16)  #: ``markers``: profile of RViz; a new subscriber gets all markers again.
#: Viewers of ``blocks``, ``block_batches``, ``executed_setpoints``: no sender waits for a viewer.
LISTENING = _last(DEPTH, BEST_EFFORT)
JOINTS = _last(10)  #: ``joint_states``: profile of RViz and recorders.
TRAJECTORY = _last(1)  #: Trajectories: the latest one replaces earlier ones.
#: Joint states of a controller: compatible with every publisher.
FEEDBACK = _last(64, BEST_EFFORT)
DIAGNOSTICS = _last(64)  #: ``/diagnostics``: profile of aggregators.
#: ``loaded_program``, ``setup_table``, ``modal_state``, ``active_modes``: later subscribers get
#: the last message.
LOADED = _last(1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
CONTACTS = _last(64)  #: ``probe_contact``: every contact must arrive.
OVERRIDE = _last(10)  #: Overrides: profile of ``ros2 topic pub``.
BEATS = _last(1, BEST_EFFORT)  #: ``jog``: a lost beat must not be resent.
