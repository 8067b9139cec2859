"""Robot languages: one folder each, with its writer, its reader and the rules on its text."""
