"""The process `trim`: a torch cuts curves out of a formed sheet."""
