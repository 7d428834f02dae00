"""What a page of the report holds in its packed part."""

import re
import zlib

import numpy as np

PACKED = re.compile(r'data-size="(\d+)">([^<]*)')


def unpacked(page):
    """The texts in the packed part of a page."""
    size, text = PACKED.search(page).groups()
    letters = np.frombuffer(text.encode('utf-32-le'), dtype=np.uint32) & 127
    bits = np.unpackbits(letters.astype(np.uint8)[:, None], axis=1)[:, 1:].ravel()
    whole = np.packbits(bits[: 8 * int(size)]).tobytes()
    return zlib.decompress(whole).decode().split('\0')
