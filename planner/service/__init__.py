"""Tandem as a service: jobs over HTTP, a store that outlives crashes, files by their content.

No planning happens here: worker processes run the pipeline. The parts need the extra ``service``; importing
this package alone does not.
"""
