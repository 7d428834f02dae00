"""text -> Block: part programs in the dialects that shops use."""
