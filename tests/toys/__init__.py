"""Packages as others would write them: what they bring is found by entry points."""
