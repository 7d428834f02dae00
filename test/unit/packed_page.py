"""What a page of the report holds in its packed part."""

import re
import zlib

PACKED = re.compile(r'data-size="(\d+)">([^<]*)')


def unpacked(page):
    """The texts in the packed part of a page."""
    size, text = PACKED.search(page).groups()
    bits = ''.join(f'{ord(letter) & 127:07b}' for letter in text)
    whole = int(bits[: 8 * int(size)], 2).to_bytes(int(size), 'big')
    return zlib.decompress(whole).decode().split('\0')
