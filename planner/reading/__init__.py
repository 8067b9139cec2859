"""Files of users: read, validated, converted to SI units."""
