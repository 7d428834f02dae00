"""The model of the drives: how axes follow, the error at the tool, and the inverse model."""
