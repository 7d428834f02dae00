"""The commands of `cnc-interp`: options, words of the shop floor, exit codes."""
