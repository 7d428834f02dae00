"""The settings of a user, each declared once."""
