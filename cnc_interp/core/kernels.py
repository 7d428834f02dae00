"""Compiled kernels of this package: numba's dispatchers with our own cache files and locks.

Numba itself is not changed, so kernels of other packages are compiled and cached as usual.
"""

from __future__ import annotations

import fcntl
import io
import os
import pickle
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

from llvmlite.binding import parse_bitcode
from numba.core import caching, ccallback, codegen, config, dispatcher, environment, sigutils
from numba.core.compiler import Compiler, CompileResult
from numba.core.registry import CPUDispatcher
from numba.core.runtime import rtsys

from cnc_interp import kernel_cache
from cnc_interp.core.compile_time import compiling


class _Library(codegen.JITCodeLibrary):  # type: ignore[misc]
    """Machine code of a kernel, loaded from its file; bitcode is parsed only for linking."""

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


class _Target:
    """Numba's target context, except that kernels from files become a ``_Library``."""

    def __init__(self, target: Any):
        self._target = target

    def __getattr__(self, name: str) -> Any:
        return getattr(self._target, name)

    def codegen(self) -> _Target:
        return self

    def unserialize_library(self, kept: tuple[str, str, Any]) -> Any:
        name, kind, code = kept
        usual = self._target.codegen()
        return (
            _Library(usual, name, *code) if kind == 'object' else usual.unserialize_library(kept)
        )


def _constants(module: str, values: list[Any], name: str) -> Any:
    """Rebuild the constants of a function without importing numba modules for the compiler."""
    found = environment.lookup_environment(name)
    if found is not None or not module.startswith('numba.'):
        return found or environment._rebuild_env(module, values, name)
    made = environment.Environment({'__name__': module})
    made.consts[:], made.env_name = values, name
    environment.Environment._memo[name] = made
    return made


class _Reader(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        return _constants if name == '_rebuild_env' else super().find_class(module, name)


class _Files(caching.IndexDataCacheFile):  # type: ignore[misc]
    """Files of a kernel; a lock keeps two processes from using one number for different forms."""

    @contextmanager
    def _locked(self, how: int) -> Iterator[None]:
        try:
            lock = os.open(Path(self._cache_path, 'lock'), os.O_RDONLY | os.O_CREAT, 0o666)
        except OSError:  # no folder yet, or one that nobody may write
            yield
            return
        try:
            fcntl.flock(lock, how)
            yield
        finally:
            os.close(lock)

    def save(self, key: Any, kept: Any) -> None:
        with self._locked(fcntl.LOCK_EX):
            super().save(key, kept)

    def load(self, key: Any) -> Any:
        with self._locked(fcntl.LOCK_SH):
            return super().load(key)

    def _load_index(self) -> Any:
        try:
            return super()._load_index()
        except (ImportError, AttributeError):  # types of another version, which have moved
            return {}

    def _load_data(self, name: str) -> Any:
        return _Reader(io.BytesIO(Path(self._data_path(name)).read_bytes())).load()


class _Form(caching.CompileResultCacheImpl):  # type: ignore[misc]
    """Storage of a kernel: its name, in the folder that ``kernel_cache`` assigns to its file."""

    def __init__(self, function: Callable[..., Any]):
        code = function.__code__
        self._lineno = code.co_firstlineno
        self._locator = kernel_cache.KernelLocator.of(code.co_filename)
        name = f'{Path(code.co_filename).stem}.{function.__qualname__}'
        self._filename_base = self.get_filename_base(name, getattr(sys, 'abiflags', ''))

    def rebuild(self, target: Any, kept: Any) -> Any:
        return CompileResult._rebuild(_Target(target), *kept)._replace(target_context=target)


class _Cache(caching.Cache):  # type: ignore[misc]
    """The files of a kernel, or those included in a wheel.

    Loading a kernel skips numba's registries and the bitcode, which only compiling needs. That
    saves half a second.
    """

    _impl_class = _Form

    def __init__(self, function: Callable[..., Any]):
        super().__init__(function)
        self._stamp = self._impl.locator.get_source_stamp()
        self._cache_file = self._files(self._cache_path)

    def _files(self, folder: str) -> _Files:
        return _Files(folder, self._impl.filename_base, self._stamp)

    def load_overload(self, signature: Any, target: Any) -> Any:
        rtsys.initialize(target)
        return self._load_overload(signature, target) or self._brought(signature, target)

    def _brought(self, signature: Any, target: Any) -> Any:
        form, (triple, _, features), code = self._index_key(signature, target.codegen())
        place = kernel_cache.brought(Path(self._cache_path), features.split(','))
        key = form, (triple, kernel_cache.PROCESSOR, ''), code
        kept = self._files(str(place)).load(key) if place else None
        return kept and self._impl.rebuild(target, kept)


class _Later:
    """The files of a kernel, looked up at its first call; its sources are recorded at import."""

    def __init__(self, function: Callable[..., Any]):
        self._function = function
        kernel_cache.KernelLocator.of(function.__code__.co_filename).get_source_stamp()

    @cached_property
    def _files(self) -> Any:
        return _Cache(self._function)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._files, name)


class _Compiler(dispatcher._FunctionCompiler):  # type: ignore[misc, name-defined]
    def _compile_core(self, args: Any, return_type: Any) -> Any:
        with compiling():
            return super()._compile_core(args, return_type)


class Kernel(CPUDispatcher):  # type: ignore[misc]
    """A function of this package that numba compiles."""

    def __init__(
        self,
        function: Callable[..., Any],
        named: Any = None,
        targetoptions: Any = None,
        pipeline_class: Any = Compiler,
    ):
        super().__init__(function, named, targetoptions, pipeline_class)
        self._compiler = _Compiler(
            function, self.targetdescr, self.targetoptions, self.locals, pipeline_class
        )

    def enable_caching(self) -> None:
        self._cache = _Later(self.py_func)

    def _compilation_chain_init_hook(self) -> None:
        """Skip numba's extensions; finding them would read the metadata of all packages."""


class _Callback(ccallback.CFunc):
    def enable_caching(self) -> None:
        self._cache = _Cache(self._pyfunc)  # type: ignore[attr-defined]

    def _compile_uncached(self) -> Any:
        with compiling():
            return super()._compile_uncached()  # type: ignore[misc]


def njit(*, cache: bool = False, pipeline_class: Any = Compiler, **options: Any) -> Any:
    """Return a decorator like ``numba.njit``, for functions of this package."""

    def compiled(function: Callable[..., Any]) -> Any:
        if config.DISABLE_JIT:
            return function
        given = {'nopython': True, 'boundscheck': None, 'no_cfunc_wrapper': True, **options}
        kernel = Kernel(function, {}, given, pipeline_class)
        if cache:
            kernel.enable_caching()
        return kernel

    return compiled


def cfunc(signature: Any, cache: bool = False) -> Any:
    """Return a decorator like ``numba.cfunc``, for functions of this package."""

    def compiled(function: Callable[..., Any]) -> Any:
        callback = _Callback(function, sigutils.normalize_signature(signature), {}, {})
        if cache:
            callback.enable_caching()
        callback.compile()
        return callback

    return compiled
