"""What exists to compare with the papers; loaded by name where a user asks for it."""
