"""Measurements of speed and memory, each beside a peer or a plain baseline in the same run."""
