"""Incremental sheet forming."""
