"""Execution of Python code: executors, a second process, memory, memoization, and the package version."""
