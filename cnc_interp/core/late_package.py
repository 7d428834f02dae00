"""A package whose ``__init__`` runs only when one of its attributes is first used."""

from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any


class LatePackage(ModuleType):
    """A package whose modules can be imported without running its ``__init__``."""

    def __init__(self, spec: ModuleSpec):
        super().__init__(spec.name)
        self.__spec__, self.__file__ = spec, spec.origin
        self.__path__ = spec.submodule_search_locations or []
        self._is_whole = False

    def _complete(self) -> None:
        loader = None if self.__spec__ is None else self.__spec__.loader
        if not self._is_whole and loader is not None:
            self._is_whole = True
            loader.exec_module(self)

    def __getattr__(self, name: str) -> Any:
        if name.startswith('__') or self._is_whole:
            raise AttributeError(f'module {self.__name__!r} has no attribute {name!r}')
        self._complete()
        return getattr(self, name)

    def __dir__(self) -> list[str]:
        self._complete()
        return list(super().__dir__())
