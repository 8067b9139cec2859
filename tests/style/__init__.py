"""Counts of what the style guide excludes, for each room of the repository.

``tests/test_language.py`` compares them with the stored table ``counts.json``: a count may fall, never rise.
``python -m tests.style --write`` stores lower counts, ``python -m tests.style ROOM`` lists what is counted.
"""
