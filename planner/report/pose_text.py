"""Points and poses as text, for tables."""

from planner.geometry.arrays import FloatArray, to_quaternion, to_rpy
from planner.geometry.units import DEG, MM
from planner.report import markup


def pose_cells(pose: FloatArray) -> tuple[str, str, str]:
    """Format position [mm], roll-pitch-yaw [deg] and quaternion (w, x, y, z) of a pose (4, 4) [m]."""
    rotation = ", ".join(markup.fixed_decimals(float(v) / DEG, 3) for v in to_rpy(pose[:3, :3]))
    quaternion = ", ".join(markup.fixed_decimals(float(v), 6) for v in to_quaternion(pose[:3, :3]))
    return point_text(pose[:3, 3]), rotation, quaternion


def point_text(at: FloatArray) -> str:
    """Format a point (3,) [m] in millimetres."""
    return ", ".join(markup.fixed_decimals(float(v) / MM, 2) for v in at)
