"""Planning of the process ``trim``: a torch, knife or mill cuts curves out of a formed sheet."""
