"""Writer of RAPID programs and of the configuration of ABB controllers."""
