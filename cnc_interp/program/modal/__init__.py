"""The modal state: the words that set it, its values, and derived values."""
