"""What the words of a block do, in the order in which a control acts on them."""
