"""One building element in, a folder of ordinary problems out."""
