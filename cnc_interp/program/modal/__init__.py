"""The modal state: which words set it, its values, and what is derived from them."""
