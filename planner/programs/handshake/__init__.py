"""Handshake between two controllers as their programs perform it."""
