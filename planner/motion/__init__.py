"""From targets to joint paths on one clock; knows no process."""
