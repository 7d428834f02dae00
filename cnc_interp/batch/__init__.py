"""Many programs on many machines: planned and proven one by one, in processes of their own."""
