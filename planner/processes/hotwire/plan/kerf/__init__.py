"""The kerf: width of the slot that a hot wire melts in foam."""
