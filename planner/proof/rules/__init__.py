"""The rules of the proof, by subject; each module names its codes."""
