"""The operator page: what the nodes do, in a browser, and the operator's keys."""
