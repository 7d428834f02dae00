"""Where compiled kernels are kept, and when they are compiled again.

Machine code holds what a kernel calls, and the constants that it reads. numba by itself compares
only the file of the kernel. Here a kernel is current while no file changes that its own file
imports from this package, directly or through others.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import re
import sys
from collections.abc import Callable, MutableMapping
from functools import cache, cached_property
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).resolve().parent
#: Kernels that a wheel brings, the processors that they fit, and what those have (numba's names).
BROUGHT, PROCESSOR = PACKAGE / 'compiled', 'x86-64-v3'
FEATURES = {'+avx2', '+bmi', '+bmi2', '+f16c', '+fma', '+lzcnt', '+movbe'}
#: The variables by which numba finds this module, and by which a user chooses another folder.
LOCATORS, FOLDER = 'NUMBA_CACHE_LOCATOR_CLASSES', 'NUMBA_CACHE_DIR'
IMPORT = re.compile(
    rf'^\s*(?:from|import) {PACKAGE.name}\.([\w.]+)(?: import (\([^)]*\)|[\w, ]+))?', re.M
)


@cache
def sources(file: Path) -> frozenset[Path]:
    """Return a file and all files of the package that it imports, directly or through others."""
    found, waiting = set[Path](), [file]
    while waiting:
        source = waiting.pop()
        if source not in found:
            found.add(source)
            waiting += _imported(source)
    return frozenset(found)


@cache
def _imported(source: Path) -> list[Path]:
    names = IMPORT.findall(source.read_text(encoding='utf-8'))
    dotted = {name for name, _ in names}
    dotted |= {f'{name}.{inner}' for name, all_ in names for inner in re.findall(r'\w+', all_)}
    places = [PACKAGE.joinpath(*name.split('.')) for name in dotted]
    files = [file for place in places for file in (Path(f'{place}.py'), place / '__init__.py')]
    return [file for file in files if file.is_file()]


@cache
def _resolved(file: str) -> Path:
    return Path(file).resolve()


@cache
def _digest(file: Path) -> bytes:
    return hashlib.sha256(file.read_bytes()).digest()


@cache
def _stamp(file: Path) -> str:
    return hashlib.sha256(b''.join(map(_digest, sorted(sources(file))))).hexdigest()


def folder() -> Path:
    """Return the folder of compiled kernels: beside the sources if possible, else the user's."""
    if FOLDER in os.environ:
        return Path(os.environ[FOLDER])
    if os.access(PACKAGE, os.W_OK):
        return PACKAGE / '__pycache__' / 'kernels'
    cache_home = os.environ.get('XDG_CACHE_HOME') or str(Path.home() / '.cache')
    return Path(cache_home) / PACKAGE.name / 'kernels'


@cache
def _one_process_at_a_time() -> None:
    """Lock numba's files: two processes would give different forms the same number."""
    from numba.core.caching import IndexDataCacheFile as Files

    def locked(act: Callable[..., Any], how: int) -> Callable[..., Any]:
        def after_lock(files: Any, *given: Any) -> Any:
            try:
                lock = os.open(Path(files._cache_path, 'lock'), os.O_RDONLY | os.O_CREAT, 0o666)
            except OSError:  # no folder yet, or one that nobody may write
                return act(files, *given)
            try:
                fcntl.flock(lock, how)
                return act(files, *given)
            finally:
                os.close(lock)

        return after_lock

    Files.save, Files.load = locked(Files.save, fcntl.LOCK_EX), locked(Files.load, fcntl.LOCK_SH)


@cache
def _load_what_runs() -> None:
    """Let a kernel be loaded without what only compiling needs, which takes half a second.

    That are numba's registries, which a compiler loads itself; the bitcode of the kernel, which is
    read when another one is compiled with it; the modules of numba's own functions inside; the
    files of kernels that are not called; and extensions of numba, for which the metadata of all
    installed packages are read.
    """
    from functools import wraps

    from llvmlite.binding import parse_bitcode
    from numba.core import caching, codegen, dispatcher, environment
    from numba.core.runtime import rtsys

    class Library(codegen.JITCodeLibrary):  # type: ignore[misc]
        """Machine code of a kernel from its file."""

        _shared_module: Any

        def __init__(self, codegen: Any, name: str, machine_code: bytes, bitcode: bytes):
            super().__init__(codegen, name)
            self._bitcode, self._shared_module = bitcode, None
            self.enable_object_caching()
            self._set_compiled_object(machine_code)
            self._finalize_final_module()

        def _get_module_for_linking(self) -> Any:
            if self._shared_module is None:
                self._shared_module = parse_bitcode(self._bitcode)
                self._codegen._engine._load_defined_symbols(self._shared_module)
            return self._shared_module

        def get_pointer_to_function(self, name: str) -> int:
            return int(self._codegen._engine.get_function_address(name))

    def library(target: Any, kept: tuple[str, str, Any]) -> Any:
        name, kind, code = kept
        return Library(target, name, *code) if kind == 'object' else usual(target, kept)

    def overload(kernel: Any, signature: Any, target: Any) -> Any:
        rtsys.initialize(target)
        with kernel._guard_against_spurious_io_errors():
            return kernel._load_overload(signature, target) or brought(kernel, signature, target)

    def brought(kernel: Any, signature: Any, target: Any) -> Any:
        form, (triple, _, features), code = kernel._index_key(signature, target.codegen())
        path = Path(kernel.cache_path)
        if not path.is_relative_to(folder()) or not FEATURES.issubset(features.split(',')):
            return None
        files = caching.IndexDataCacheFile(
            str(BROUGHT / path.relative_to(folder())),
            kernel._impl.filename_base,
            kernel._cache_file._source_stamp,
        )
        data = files.load((form, (triple, PROCESSOR, ''), code))
        return data and kernel._impl.rebuild(target, data)

    @wraps(rebuild := environment._rebuild_env)
    def constants(module: str, values: list[Any], name: str) -> Any:
        found = environment.lookup_environment(name)
        if found is not None or not module.startswith('numba.'):
            return found or rebuild(module, values, name)
        made = environment.Environment({'__name__': module})
        made.consts[:], made.env_name = values, name
        environment.Environment._memo[name] = made
        return made

    class Later:
        """The files of a kernel, sought when it is called; its sources count as imported."""

        def __init__(self, function: Callable[..., Any]):
            self._function = function
            _stamp(_resolved(function.__code__.co_filename))

        @cached_property
        def _files(self) -> Any:
            return caching.FunctionCache(self._function)

        def __getattr__(self, name: str) -> Any:
            return getattr(self._files, name)

    def is_ours(function: Callable[..., Any]) -> bool:
        return function.__module__.startswith(f'{PACKAGE.name}.')

    def files(function: Callable[..., Any]) -> Any:
        return (Later if is_ours(function) else caching.FunctionCache)(function)

    def begin(kernel: Any) -> None:
        if not is_ours(kernel.py_func):
            usual_begin(kernel)

    untyped: Any = dispatcher
    usual_begin = untyped.Dispatcher._compilation_chain_init_hook
    untyped.Dispatcher._compilation_chain_init_hook, untyped.FunctionCache = begin, files
    usual = codegen.JITCPUCodegen.unserialize_library
    codegen.JITCPUCodegen.unserialize_library = library
    caching.Cache.load_overload, environment._rebuild_env = overload, constants


class KernelLocator:
    """Tells numba where the code of a kernel is kept, and whether it is current."""

    def __init__(self, file: Path):
        self._py_file = file  # numba names it in warnings
        self._folder = folder() / file.relative_to(PACKAGE).parent

    @classmethod
    def from_function(cls, _function: Callable[..., Any], file: str) -> KernelLocator | None:
        """Return the locator of a function, None if it belongs to another package."""
        from cnc_interp.core import compile_time  # noqa: F401 - it needs numba, and hears it

        path = _resolved(file)
        _one_process_at_a_time()
        _load_what_runs()
        return cls(path) if path.is_relative_to(PACKAGE) else None

    def ensure_cache_path(self) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> str:
        return _stamp(self._py_file)

    def get_disambiguator(self) -> str:
        """Return what tells functions of one name apart; a name stands once in a file here."""
        return PACKAGE.name


def register(environment: MutableMapping[str, str]) -> None:
    """Let numba ask this module first; other packages keep numba's own way."""
    ours = f'{__name__}.{KernelLocator.__name__}'
    environment.setdefault(LOCATORS, f'{ours},InTreeCacheLocator,UserWideCacheLocator')
    if 'numba.core.config' in sys.modules:  # somebody else has imported numba before
        sys.modules['numba.core.config'].reload_config()
