"""What the six generators of the message build do again and again is done once.

Each message is parsed once, each template is scanned once for all messages, and its expressions
are compiled once. Python reads this at its start, because ``build_messages`` names this folder in
PYTHONPATH.
"""

import builtins
import hashlib
import os
import pickle
import sys
from functools import cache
from pathlib import Path
from typing import Any

if '--generator-arguments-file' in sys.orig_argv:
    import em
    from rosidl_parser import parser

    parse = parser.parse_idl_string

    def parse_once(text: str) -> Any:
        kept = Path('parsed', hashlib.sha256(text.encode()).hexdigest())  # below the build folder
        if not kept.exists():
            new = kept.with_suffix(f'.{os.getpid()}')
            new.parent.mkdir(exist_ok=True)
            new.write_bytes(pickle.dumps(parse(text)))
            new.replace(kept)
        return pickle.loads(kept.read_bytes())

    parser.parse_idl_string = lambda text, png_file=None: parse_once(text)

    @cache
    def place(scan: Any, rest: str, *given: Any) -> Any:
        return scan(em.Scanner('@', rest), *given)

    @cache
    def code(text: str, kind: str) -> Any:
        return compile(text.lstrip(' \t') if kind == 'eval' else text, '<template>', kind)

    for name in 'complex', 'next':
        scan = getattr(em.Scanner, name)
        found = lambda scanner, *given, scan=scan: place(scan, scanner.rest(), *given)  # noqa: E731
        setattr(em.Scanner, name, found)
    em.eval = lambda text, *given: builtins.eval(code(text, 'eval'), *given)
    em._exec = lambda text, *given: builtins.exec(code(text, 'exec'), *given)
