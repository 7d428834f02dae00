"""Execution of the words of a block, in the order in which a control acts on them."""
