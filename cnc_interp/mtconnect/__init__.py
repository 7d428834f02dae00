"""What the machine does, for the shop: an MTConnect agent that only reads."""
