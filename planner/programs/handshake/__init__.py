"""Handshake between two controllers as their programs execute it."""
