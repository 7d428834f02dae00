"""Whether anything is hit: bodies of machine, tools, clamps and stock along the path q(s)."""
