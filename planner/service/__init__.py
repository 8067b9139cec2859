"""HTTP service: a queue of jobs, a persistent store and content-addressed files.

Worker processes run the planning pipeline. The modules need the extra ``service``. Importing this package
alone does not.
"""
