"""Measured test cuts as arrays, the tables of the dissertation (docs/kerf.md), and the wire of its tests."""

import csv
import dataclasses
import functools
import math
from pathlib import Path
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray
from planner.geometry.units import MM
from planner.issues import issue_error
from planner.processes.hotwire.plan.wire import HeatedWire

_DATA_FOLDER: Final = Path(__file__).resolve().parents[4] / "data"
"""Folder with the tables of test cuts."""
TEST_WIRE_LENGTH_M: Final = 0.43
"""Heated length of the wire in the dissertation's tests [m]."""
TEST_WIRE_DIAMETER_M: Final = 0.0004
"""Diameter of the wire in the dissertation's tests [m]."""


@dataclasses.dataclass(frozen=True)
class CutMeasurements:
    """N test cuts in one foam.

    Attributes:
        power_per_length: Power per length of the wire (N,) [W/m].
        speed: Speed of the wire (N,) [m/s].
        width: Width of the slot (N,) [m].
    """

    power_per_length: FloatArray
    speed: FloatArray
    width: FloatArray

    def __len__(self) -> int:
        return len(self.width)

    def select(self, mask: BoolArray) -> "CutMeasurements":
        """Return the cuts where ``mask`` (N,) is true."""
        return CutMeasurements(self.power_per_length[mask], self.speed[mask], self.width[mask])


@dataclasses.dataclass(frozen=True)
class CutTable:
    """The N = 32 cells of one foam in the dissertation.

    Attributes:
        cuts: Power, speed and measured width. The width is NaN where the measured value is lost.
        power: Power (N,) [W].
        voltage: Voltage (N,) [V].
        calculated: Width as the dissertation calculates it (N,) [m].
        burnt: Whether a cell is shaded as burnt (N,).
        dragging: Whether a cell is shaded as dragging (N,).
    """

    cuts: CutMeasurements
    power: FloatArray
    voltage: FloatArray
    calculated: FloatArray
    burnt: BoolArray
    dragging: BoolArray

    @property
    def valid(self) -> BoolArray:
        """Whether a cell was measured and is not burnt (N,)."""
        return np.isfinite(self.cuts.width) & ~self.burnt


@functools.lru_cache(maxsize=1)
def dissertation_tables() -> dict[str, CutTable]:
    """Return tables 2 to 5 of the dissertation by foam."""
    rows = _read_csv("kerf_cuts.csv")
    return {
        name: _make_cut_table([row for row in rows if row["foam"] == name])
        for name in {r["foam"]: 0 for r in rows}
    }


@functools.lru_cache(maxsize=1)
def air_table() -> dict[str, FloatArray]:
    """Return properties of dry air at 18 temperatures, as arrays (18,) by name.

    Returns:
        ``temperature`` [C], ``density`` [kg/m^3], ``heat`` [J/(kg K)], ``conductivity`` [W/(m K)] and
        ``viscosity`` [m^2/s] (kinematic).
    """
    rows = _read_csv("kerf_air.csv")

    def column(name: str, unit: float = 1.0) -> FloatArray:
        return np.array([float(row[name]) for row in rows]) * unit

    return {
        "temperature": column("temperature_c"),
        "density": column("density_kg_m3"),
        "heat": column("specific_heat_kj_kg_k", 1e3),
        "conductivity": column("conductivity_w_m_k"),
        "viscosity": column("viscosity_1e6_m2_s", 1e-6),
    }


def _make_cut_table(rows: list[dict[str, str]]) -> CutTable:
    """Return the table of one foam from the rows of the file. Empty cells become NaN."""

    def column(name: str) -> FloatArray:
        return np.array([float(row[name]) if row[name] else np.nan for row in rows])

    power = column("power_w")
    cuts = CutMeasurements(power / TEST_WIRE_LENGTH_M, column("speed_mm_s") * MM, column("measured_mm") * MM)
    shading = [row["shading"] for row in rows]
    return CutTable(
        cuts=cuts,
        power=power,
        voltage=column("voltage_v"),
        calculated=column("calculated_mm") * MM,
        burnt=np.array([s.startswith("burnt") for s in shading]),
        dragging=np.array([s.startswith("dragging") for s in shading]),
    )


def _read_csv(name: str) -> list[dict[str, str]]:
    """Return the rows of a data file as values by heading, without comment lines."""
    with (_DATA_FOLDER / name).open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(line for line in stream if not line.startswith("#")))


@dataclasses.dataclass(frozen=True)
class HotWire:
    """A straight wire whose power is spread evenly over its heated length.

    Attributes:
        diameter: Diameter [m].
        length: Heated length [m].

    Raises:
        TandemError: kerf.input, unless both are finite and above 0.
    """

    diameter: float
    length: float

    def __post_init__(self) -> None:
        for name in ("diameter", "length"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                text = f"{name} of the hot wire: got {value / MM:g} mm, allowed above 0"
                raise issue_error("kerf.input", text, field=name, hint=f"give the wire's {name}")

    @staticmethod
    def from_wire(wire: HeatedWire, length: float) -> "HotWire":
        """Return a wire with a heated length [m]. A strip counts by its thickness."""
        return HotWire(wire.thickness, length)


TEST_WIRE: Final = HotWire(TEST_WIRE_DIAMETER_M, TEST_WIRE_LENGTH_M)
"""Wire of the dissertation's test cuts."""
