"""The operator side: run, record, replay, and the page."""
