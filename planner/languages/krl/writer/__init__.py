"""KRL for KUKA controllers."""
