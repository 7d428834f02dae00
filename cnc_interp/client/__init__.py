"""The operator's side: running, recording and replaying programs; commands of the page."""
