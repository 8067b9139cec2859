"""Trimming of formed sheets with a torch, a laser, a knife or a mill."""
