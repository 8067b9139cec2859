"""Verified programs to controllers and back: files alone, nothing is started."""
