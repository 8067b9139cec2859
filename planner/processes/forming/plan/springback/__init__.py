"""In-process springback: elastic recovery of the formed sheet when the tool releases it."""
