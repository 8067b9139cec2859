"""Stored digests, rule order and start-up imports that a refactoring must not change.

| file | content |
|---|---|
| ``digests.json`` | SHA-256 of all results of each bundled problem and its issues, also without words |
| ``rule_codes.txt`` | codes of the proof rules, in the order in which they run |
| ``startup_imports.py`` | modules that start-up imports |

A change that means to alter one of them writes it anew::

    python -m tests.freeze --write                       # everything; about half an hour of processor time
    python -m tests.freeze --write gauge_lanes engrave   # digests of these problems only
    python -m tests.freeze --write --resume              # digests that the table does not have yet
    python -m tests.freeze --write rules imports         # the two lists only, in seconds
"""
