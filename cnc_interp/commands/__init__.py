"""The commands of `cnc-interp`: their options in shop-floor terms, and their exit codes."""
