"""Bags (rosbag2, MCAP) with every message of a run; write, read and repair them."""

from __future__ import annotations

import json
import tempfile
from array import array
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO

from cnc_interp_msgs import msg
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rosbags import interfaces
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from sensor_msgs.msg import JointState

from cnc_interp.core import InterpError, StreamError, small_files
from cnc_interp.nodes import qos
from cnc_interp.nodes.streams import is_spoilt, opened

#: Recorded topic -> message type, and quality of service.
TOPICS: dict[str, tuple[Any, QoSProfile]] = {
    'loaded_program': (msg.LoadedProgram, qos.LOADED),
    'setup_table': (msg.SetupTable, qos.LOADED),
    'blocks': (msg.G1Block, qos.STREAM),
    'block_batches': (msg.G1BlockBatch, qos.STREAM),
    'segments': (msg.PathSegmentBatch, qos.STREAM),
    'setpoints': (msg.SetpointChunk, qos.SETPOINTS),
    'executed_setpoints': (msg.SetpointChunk, qos.STREAM),
    'axis_feedback': (msg.AxisFeedback, qos.STREAM),
    'followed_spindle': (msg.FollowedSpindle, qos.STREAM),
    'stream_status': (msg.StreamStatus, qos.STATUS),
    'machine_state': (msg.MachineState, qos.STATE),
    'machine_signals': (msg.MachineSignals, qos.LOADED),
    'probe_contact': (msg.ProbeContact, qos.CONTACTS),
    'joint_states': (JointState, qos.JOINTS),
    '/diagnostics': (DiagnosticArray, qos.DIAGNOSTICS),
}
#: Topics whose messages end with a checksum.
SEALED = ('blocks', 'block_batches', 'segments', 'setpoints')
PARAMETER = 'parameter.'  #: Prefix of node parameters in the custom data of a bag.
NOTED = 'noted.json'  #: File beside an open bag, with its custom data.
ENDLESS = interfaces.QosTime(2147483647, 4294967295)


def type_name(kind: Any) -> str:
    package, folder, _ = kind.__module__.split('.', 2)
    return f'{package}/{folder}/{kind.__name__}'


def types() -> Any:
    """Return a type store with ROS's message types and those of this package."""
    store = get_typestore(Stores.ROS2_JAZZY)
    try:
        folder = small_files.share_directory('cnc_interp_msgs') / 'msg'
    except LookupError:
        raise InterpError('cnc_interp_msgs is not installed; source the workspace') from None
    for file in sorted(folder.glob('*.msg')):
        name = f'cnc_interp_msgs/msg/{file.stem}'
        store.register(get_types_from_msg(file.read_text(encoding='utf-8'), name))
    return store


def offered(profile: QoSProfile) -> interfaces.Qos:
    """Return a quality of service in the form of bag metadata; players then offer the same."""
    return interfaces.Qos(
        interfaces.QosHistory.KEEP_LAST,
        profile.depth,
        interfaces.QosReliability.RELIABLE,
        interfaces.QosDurability[profile.durability.name],
        ENDLESS,
        ENDLESS,
        interfaces.QosLiveliness.AUTOMATIC,
        ENDLESS,
        False,
    )


def refuse_existing(path: Path) -> None:
    """Raise InterpError if ``path``, where a new bag is to be written, already exists."""
    if path.exists():
        raise InterpError(f'{path} exists already; name a new folder for the bag')


LOST_AT_MOST = 1_000_000_000  #: If the recorder is killed, at most this time is lost [ns].


class BagWriter:
    """A bag that is being written; ``close`` completes it."""

    def __init__(self, path: Path):
        refuse_existing(path)
        self.count = 0
        self._path, self._noted = path, dict[str, str]()
        self.fault: OSError | None = None  #: Error that ended writing.
        self._stored_at = 0  # stamp [ns] up to which all messages are in the file
        self._writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
        self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._writer.open()
        store = types()
        self._connections = {
            topic: self._writer.add_connection(
                f'/{topic.removeprefix("/")}',
                type_name(kind),
                typestore=store,
                offered_qos_profiles=[offered(profile)],
            )
            for topic, (kind, profile) in TOPICS.items()
        }

    def note(self, node: str, parameters: dict[str, Any]) -> None:
        self.keep({f'{PARAMETER}{node}.{k}': json.dumps(v) for k, v in parameters.items()})

    def keep(self, noted: dict[str, str]) -> None:
        """Store custom data in a file beside the bag now, and in the bag when it is closed."""
        self._noted |= noted
        for name, value in noted.items():
            self._writer.set_custom_data(name, value)
        try:
            (self._path / NOTED).write_text(json.dumps(self._noted))
        except OSError as fault:
            self.fault = fault

    def write(self, topic: str, data: bytes, stamp: int) -> None:
        """Write a serialised message and its time of arrival [ns]; for errors see ``close``."""
        if self.fault is None:
            try:
                self._writer.write(self._connections[topic], stamp, data)
                self.count += 1
                if stamp - self._stored_at > LOST_AT_MOST:
                    storage: Any = self._writer.storage
                    storage.close_chunk()
                    storage.bio.flush()
                    self._stored_at = stamp
            except OSError as fault:  # no reason to stop a machine
                self.fault = fault

    def close(self) -> None:
        """Write the index and the metadata of the bag.

        Raises OSError if they or a message could not be written, because the disk is full.
        """
        try:
            if self.fault is not None:
                raise self.fault
            self._writer.close()
            (self._path / NOTED).unlink(missing_ok=True)
        except OSError as fault:
            reason = f'{fault.strerror}; the record of the run is not complete'
            raise OSError(fault.errno, reason, str(self._path)) from None


def files_of(path: Path) -> list[Path]:
    """Return the files of a bag; raise unless all are regular files with readable YAML."""
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    files = [file for file in files if file.suffix in ('.mcap', '.db3', '.yaml', '.zstd')]
    for file in files:
        file.stat()
        if not file.is_file():
            raise small_files.UnreadableError(f'{file.name} is not a file')
        if file.suffix == '.yaml':
            small_files.read_yaml(file)
    return files


def why(fault: Exception) -> str:
    """Return in one line why a file cannot be read, from the exception."""
    if isinstance(fault, MemoryError):
        return 'it would unpack to far more than a file of this size can contain'
    return ' '.join(str(fault).split())[:200] or type(fault).__name__


class SpooledMessages(Sequence[Any]):
    """Messages in a temporary file; each one is read when it is needed."""

    def __init__(
        self,
        file: BinaryIO,
        ends: Sequence[int],
        read: Callable[[bytes], Any],
        places: Sequence[int] | None = None,
    ):
        self._file, self._ends, self._read = file, ends, read
        self._places = range(len(ends) - 1) if places is None else places

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, key: Any) -> Any:
        place = self._places[key]
        self._file.seek(self._ends[place])
        return self._read(self._file.read(self._ends[place + 1] - self._ends[place]))

    def where(self, holds: Callable[[Any], bool]) -> SpooledMessages:
        places = array('q', (k for k, m in zip(self._places, self, strict=True) if holds(m)))
        return SpooledMessages(self._file, self._ends, self._read, places)


class Bag:
    """A bag that is opened for reading; raises InterpError if the bag is damaged."""

    def __init__(self, path: Path):
        self.path = path
        self._reader: Reader | None = None
        self._bounds: small_files.BoundedMemory | None = None
        try:
            self._bounds = small_files.BoundedMemory(*files_of(path))
            self._reader = Reader(path)
            self._reader.open()
            custom = dict(self._reader.storage.metadata.custom or {})
            self.parameters = {
                key.removeprefix(PARAMETER): json.loads(value)
                for key, value in custom.items()
                if key.startswith(PARAMETER)
            }
            self.duration = self._reader.duration * 1e-9
        except Exception as fault:  # an unsound file makes rosbags raise anything
            self._release()
            reason = why(fault)
            if (path / NOTED).exists() or 'magic' in reason:
                reason += f'; if its recorder was killed: cnc-interp repair {path} --out NEW'
            raise InterpError(f'{path}: not a bag that can be read ({reason})') from None

    def raw(self, *topics: str) -> Iterator[tuple[str, int, bytes]]:
        """Yield topic, time [ns] and bytes of each message of ``topics``, in the order of time."""
        names = {f'/{topic.removeprefix("/")}': topic for topic in topics}
        reader = self._reader
        assert reader is not None
        wanted: list[interfaces.Connection] = [c for c in reader.connections if c.topic in names]
        try:
            found = reader.messages(wanted) if wanted else iter(())
            while (message := next(found, None)) is not None:
                connection, stamp, data = message
                yield names[connection.topic], stamp, bytes(data)
        except Exception as fault:
            raise InterpError(f'{self.path}: cannot be read to its end ({why(fault)})') from None

    def read(self, topic: str) -> list[Any]:
        return list(self.messages(topic))

    def machine(self, other: str | None = None) -> str:
        """Return the machine that the user names (``other``), else that of the recorded nodes."""
        name = other or str(self.parameters.get('machine_node.machine', ''))
        if not name:
            raise InterpError(f'{self.path}: does not name the machine; name it with --machine')
        return name

    def messages(self, topic: str) -> Iterator[Any]:
        """Yield all undamaged messages of a topic, one at a time."""
        sound = (self.sound(topic, data) for _, _, data in self.raw(topic))
        return (message for message in sound if message is not None)

    def sound(self, topic: str, data: bytes) -> Any:
        """Return a message from its bytes; None if it was damaged in transit and then resent."""
        try:
            return self.message(topic, data)
        except StreamError:
            return None

    def spooled(self, topic: str) -> SpooledMessages:
        """Return all undamaged messages of a topic, stored in a temporary file."""
        file, ends = tempfile.TemporaryFile(), array('q', [0])  # noqa: SIM115
        try:
            for _, _, data in self.raw(topic):
                if topic in SEALED and is_spoilt(data):
                    continue
                file.write(data)
                ends.append(ends[-1] + len(data))
            file.flush()
        except OSError as fault:
            raise InterpError(f'{self.path}: cannot be unpacked ({why(fault)})') from None
        return SpooledMessages(file, ends, lambda data: self.message(topic, data))

    def message(self, topic: str, data: bytes) -> Any:
        """Return a message from its bytes.

        Raises StreamError if its checksum is wrong, and InterpError if it is not a message of this
        topic.
        """
        kind = TOPICS[topic][0]
        try:
            return opened(data, kind) if topic in SEALED else deserialize_message(data, kind)
        except StreamError:
            raise
        except Exception as fault:
            reason = f'a message of {topic} cannot be read, of another version? ({why(fault)})'
            raise InterpError(f'{self.path}: {reason}') from None

    def close(self) -> None:
        reader, self._reader = self._reader, None
        if reader is not None:
            reader.close()
        self._release()

    def _release(self) -> None:
        if self._bounds is not None:
            self._bounds.lift()

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def repair(path: Path, out: Path) -> tuple[int, float]:
    """Write the messages of a bag whose recorder was killed to a valid bag.

    Returns
    -------
        Number of messages, and time from the first to the last message [s].

    Raises
    ------
    InterpError
        If the bag has no message, or if ``out`` exists.
    """
    from mcap.records import Channel, Message

    files = sorted(path.glob('*.mcap'))
    if not files:
        raise InterpError(f'{path}: no bag; it has no .mcap file')
    writer, stamps = BagWriter(out), [0]
    if (path / NOTED).exists():
        writer.keep(small_files.read_json(path / NOTED))
    names = {f'/{topic.removeprefix("/")}': topic for topic in TOPICS}
    for file in files:
        topics: dict[int, str] = {}
        for record in _whole_records(file):
            if isinstance(record, Channel):
                topics[record.id] = names[record.topic]
            elif isinstance(record, Message):
                writer.write(topics[record.channel_id], record.data, record.log_time)
                stamps = [stamps[0] or record.log_time, record.log_time]
    writer.close()
    if not writer.count:
        raise InterpError(f'{path}: it contains no complete message')
    return writer.count, (stamps[-1] - stamps[0]) * 1e-9


def _whole_records(file: Path) -> Iterator[Any]:
    """Yield the MCAP records of a file up to its end or to the first incomplete record."""
    from mcap.stream_reader import StreamReader

    with file.open('rb') as stream:
        records = iter(StreamReader(stream, validate_crcs=True).records)
        while True:
            try:
                yield next(records)
            except Exception:  # an incomplete record may contain anything
                return
