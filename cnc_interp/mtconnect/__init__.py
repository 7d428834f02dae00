"""An MTConnect agent that reports the machine's state to the shop; it only reads."""
