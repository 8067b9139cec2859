"""Transfer of verified programs to controllers and back. Only files are handled; nothing is started."""
