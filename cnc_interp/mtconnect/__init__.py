"""An MTConnect agent that reports the state of the machine. It cannot control the machine."""
