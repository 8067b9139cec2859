"""The page that the service serves: templates, style and scripts of its own, no build step, no internet."""
