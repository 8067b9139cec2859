"""Proof that the motion passes the poses that the user supplied."""
