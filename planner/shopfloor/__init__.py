"""Shop floor: base poses from probed points, programs on controllers, scans of formed parts."""
