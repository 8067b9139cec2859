"""Part files and problem entries for tests of the proof's readers."""

import numpy as np


def with_absolute_files(source, folder):
    """The problem's source, where file names are absolute."""
    if isinstance(source, dict):
        return {
            k: str(folder / v) if k == "file" else with_absolute_files(v, folder) for k, v in source.items()
        }
    return [with_absolute_files(v, folder) for v in source] if isinstance(source, list) else source


def grid_obj(path, height, cells=12, scale=1.0):
    """A mesh over a rectangle of 120 x 80, quads, in ``scale`` units of a millimetre."""
    x, y = np.meshgrid(np.linspace(0, 120, cells + 1), np.linspace(0, 80, cells + 1), indexing="ij")
    places = np.column_stack([x.ravel(), y.ravel(), height(x, y).ravel()]) * scale
    lines = ["v " + " ".join(f"{v:.9g}" for v in place) for place in places]
    for i in range(cells):
        for j in range(cells):
            a = i * (cells + 1) + j + 1
            lines.append(f"f {a} {a + cells + 1} {a + cells + 2} {a + 1}")
    path.write_text("\n".join(lines) + "\n")


def hills(x, y):
    """A face that is like no other one turned or mirrored."""
    return 40.0 + 6.0 * np.sin(x / 30.0) + 0.002 * x * y + 4.0 * np.cos(y / 20.0)


LOW = [[0, 0, 0], [60, 30, 0], [100, 30, 10], [180, -20, 0]]
HIGH = [[0, 10, 120], [70, 60, 130], [110, 45, 120], [190, -60, 125]]
