"""What an entry of a machine file needs."""

from cnc_interp.core import MachineError


def demand(holds: object, text: str, key: str = '') -> None:
    """Raise MachineError about the entry ``key`` unless what it needs holds."""
    if not holds:
        raise MachineError(text, key)
