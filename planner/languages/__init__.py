"""Robot languages. Each has a folder with its writer, its reader and the rules on its text."""
