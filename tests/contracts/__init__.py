"""Import contracts of the package, and the exceptions that are still to be removed.

The contracts are in ``.importlinter``. ``ignore_imports`` of a contract holds intended imports, which have a
wildcard, and exceptions, which have none. Both must match an import, so the list of exceptions only shrinks::

    python -m tests.contracts                      # count exceptions, find missing and obsolete ones
    python -m tests.contracts --write              # remove obsolete exceptions
    python -m tests.contracts --write --allow-new  # also add exceptions, for example after a file was split
"""
