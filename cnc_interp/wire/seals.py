"""Seals: bytes appended to a message that prove which node has sent it.

A seal contains the number of the sender, the number of the message, and a code. The code is the
first eight bytes of an HMAC-SHA-256 of namespace, topic and message. Its key is a secret that the
nodes of one user share. Other readers ignore the bytes after a message. DDS delivers multiples of
four bytes to another process, so the message is padded to such a multiple before its seal.
"""

from __future__ import annotations

import hmac
import math
import os
import secrets
import stat
import struct
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

from cnc_interp.core import InterpError

KEY_FILE = 'CNC_INTERP_KEY_FILE'  #: Environment variable with the path of the key file.
LAYOUT = struct.Struct('<II')  #: Numbers of sender and message.
CODE = 8  #: Length of the code [bytes].
SIZE = LAYOUT.size + CODE
ALIGNED = 4  #: DDS delivers messages in multiples of this size [bytes].
KEY = 32  #: Length of a key [bytes].
SILENT = 1.0  #: If a sender is silent for this time, another one may replace it [s].


def key_file() -> Path:
    """Return the path of the key file. The default file exists until the computer restarts."""
    named = os.environ.get(KEY_FILE)
    return Path(named) if named else Path(f'/dev/shm/cnc_interp_{os.getuid()}.key')


@cache
def key_in(path: Path) -> bytes:
    """Return the key in a file, or create it. InterpError if other users can access the file."""
    made = path.with_name(f'{path.name}.{secrets.token_hex(8)}')
    try:
        if not path.exists():
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL
            with os.fdopen(os.open(made, flags, 0o600), 'wb') as file:
                file.write(secrets.token_bytes(KEY))
            with suppress(FileExistsError):  # another node was faster
                os.link(made, path)
            made.unlink()
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), 'rb') as file:
            found = os.fstat(file.fileno())
            key = file.read(KEY + 1) if stat.S_ISREG(found.st_mode) else b''
    except OSError as problem:
        raise InterpError(f'{path}: the key of the nodes: {problem.strerror}') from None
    if len(key) != KEY or found.st_mode & 0o077 or found.st_uid not in (0, os.getuid()):
        text = f'must be a file of yours with {KEY} bytes that nobody else can read; remove it'
        raise InterpError(f'{path}: the key of the nodes {text}')
    return key


class Place(NamedTuple):
    """Namespace and topic of sealed messages, and the key of the nodes."""

    name: bytes
    key: bytes

    @staticmethod
    def of(name: str) -> Place:
        return Place(name.encode() + b'\0', key_in(key_file()))

    def code(self, data: bytes) -> bytes:
        return hmac.digest(self.key, self.name + data, 'sha256')[:CODE]


class Seal:
    """Seals the messages of one sender on one topic."""

    def __init__(self, place: Place):
        self._place, self._sender, self._number = place, secrets.randbits(32), 0

    def on(self, data: bytes) -> bytes:
        """Return a serialised message with its seal appended."""
        data += bytes(-len(data) % ALIGNED) + LAYOUT.pack(self._sender, self._number % 2**32)
        self._number += 1
        return data + self._place.code(data)


SECOND = 'comes from a second sender'
WAITS = 'waits for the first sender to be silent'


class KnownSender:
    """The one accepted sender of a topic: the first that is heard, until it falls silent.

    ``numbered``: whether messages contain their own numbers; late and repeated messages are then
    accepted here. A second sender may be a lost node that was restarted. Its messages are
    therefore counted, and reported only if the first sender is heard again.
    """

    def __init__(self, numbered: bool = False):
        self._numbered = numbered
        self.waiting = 0  #: Messages of a second sender since the last of the first.
        self._sender, self._number, self._heard = -1, -1, -math.inf
        self._past: set[int] = set()

    def fault(self, sender: int, number: int, now: float) -> str:
        """Return why a message with a valid seal is ignored; '' if it is accepted."""
        if sender != self._sender:
            if sender in self._past:
                return SECOND
            if now - self._heard < SILENT:
                self.waiting += 1
                return WAITS
            self._past.add(self._sender)
            self._sender, self._number, self.waiting = sender, -1, 0
        if number <= self._number and not self._numbered:
            return 'came before'
        self._number, self._heard = number, now
        return ''


def opened_seal(place: Place, data: bytes) -> tuple[bytes, int, int] | None:
    """Return message, sender and message number; None if the seal is invalid."""
    body = data[:-CODE]
    if len(data) <= SIZE or not hmac.compare_digest(data[-CODE:], place.code(body)):
        return None
    return (body[: -LAYOUT.size], *LAYOUT.unpack(body[-LAYOUT.size :]))
