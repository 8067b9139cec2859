"""Writer of KRL programs and of the controller files for KUKA controllers."""
