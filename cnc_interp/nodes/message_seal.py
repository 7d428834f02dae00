"""Checksums of messages: what was spoilt on its way is seen and sent again."""

from __future__ import annotations

import zlib
from typing import Any

from rclpy.serialization import deserialize_message, serialize_message

from cnc_interp.core.errors import Refusal, StreamError

#: Bytes of a checksum.
CHECKSUM = 4


def sealed(message: Any) -> bytes:
    """Serialise a message whose last field is a checksum of all before it."""
    message.checksum = 0
    data = serialize_message(message)
    return bytes(data[:-CHECKSUM]) + zlib.crc32(data[:-CHECKSUM]).to_bytes(CHECKSUM, 'little')


def opened(data: bytes, kind: Any) -> Any:
    """
    Read a message and compare its checksum, where one is given.

    Parameters
    ----------
    data : bytes
        The serialised message.

    Raises
    ------
    StreamError
        If the message was spoilt on its way.

    """
    given = int.from_bytes(data[-CHECKSUM:], 'little')
    if given and given != zlib.crc32(data[:-CHECKSUM]):
        text = 'a message was spoilt on its way (checksum); it is sent again'
        raise StreamError(text, Refusal.SPOILT)
    try:
        return deserialize_message(data, kind)
    except Exception as fault:
        text = f'a message cannot be read ({fault}); it is sent again'
        raise StreamError(text, Refusal.SPOILT) from None
