"""The choices of a user, each declared once."""
