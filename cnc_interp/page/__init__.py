"""The operator page: a view of the nodes in a browser, with the operator's keys."""
