"""A wire or strip at its working temperature: weight, stiffness, smallest bend radius and cold length."""

import dataclasses
import math
from typing import Literal

from planner.catalogue.materials import WireMaterial, wire_material
from planner.geometry.units import GRAVITY, MM, measurement
from planner.issues import Issue, TandemError
from planner.processes.hotwire.plan.elastica.clamped import StiffnessRatios, round_section, strip_section


@dataclasses.dataclass(frozen=True)
class HeatedWire:
    """A wire at its working temperature.

    The section is the cold one. Heat widens it by less than 1 %.

    Attributes:
        material: Material of the wire.
        kind: ``round``, or ``strip``, which bends across its thin side.
        width: Width of a strip, or diameter [m].
        thickness: Thickness of a strip, or diameter [m].
        temperature: Temperature of the hot wire [C].
    """

    material: WireMaterial
    kind: Literal["round", "strip"]
    width: float
    thickness: float
    temperature: float

    @property
    def youngs_modulus(self) -> float:
        """Young's modulus [Pa] of the hot wire."""
        return self.material.young(self.temperature)

    @property
    def area(self) -> float:
        """Cross-section area [m^2]."""
        bounding_area = self.width * self.thickness
        return math.pi / 4.0 * bounding_area if self.kind == "round" else bounding_area

    @property
    def bending_stiffness(self) -> float:
        """Bending stiffness EI [N m^2] about the soft axis, in the plane of the wire's shape.

        EI = E pi d^4 / 64 for a round wire and E w t^3 / 12 for a strip.
        """
        if self.kind == "round":
            return self.youngs_modulus * math.pi * self.thickness**4 / 64.0
        return self.youngs_modulus * self.width * self.thickness**3 / 12.0

    @property
    def torsional_stiffness(self) -> float:
        """Torsional stiffness GJ [N m^2]."""
        return self.bending_stiffness * self.stiffness_ratios.torsion

    @property
    def stiffness_ratios(self) -> StiffnessRatios:
        """Stiffness ratios that decide stability out of the plane."""
        if self.kind == "round":
            return round_section(self.material.poisson)
        return strip_section(self.width / self.thickness, self.material.poisson)

    @property
    def weight_per_length(self) -> float:
        """Weight per length [N/m]."""
        return self.material.density * self.area * GRAVITY

    @property
    def load_over_stiffness(self) -> float:
        """Weight per length over EI [1/m^3]. Times the unit vector of gravity it is the load q of `heavy`."""
        return self.weight_per_length / self.bending_stiffness

    @property
    def min_bend_radius(self) -> float:
        """Smallest radius [m] of the wire's axis without permanent bend.

        It is half the thickness over the elastic strain.
        """
        return 0.5 * self.thickness / self.material.elastic_strain

    @property
    def max_curvature(self) -> float:
        """Largest curvature [1/m] without permanent bend: 1 / min_bend_radius."""
        return 1.0 / self.min_bend_radius

    @property
    def thermal_strain(self) -> float:
        """Thermal strain: elongation per cold length."""
        return self.material.thermal_strain(self.temperature)

    def cold_length(self, hot_length: float) -> float:
        """Return the length [m] to cut at 20 C for a hot length [m]."""
        return hot_length / (1.0 + self.thermal_strain)

    @property
    def resistance_per_length(self) -> float:
        """Resistance per length [ohm/m] of the hot wire."""
        return self.material.resistivity_at(self.temperature) / self.area


def make_wire(
    material: str,
    diameter_mm: float | None = None,
    width_mm: float | None = None,
    thickness_mm: float | None = None,
    temperature_c: float = 20.0,
) -> HeatedWire:
    """Create a round wire, or a strip if no diameter is given.

    Args:
        material: Name of the wire material.
        diameter_mm: Diameter of a round wire [mm].
        width_mm: Width of a strip [mm].
        thickness_mm: Thickness of a strip, at most its width [mm].
        temperature_c: Temperature of the hot wire [C].

    Raises:
        TandemError: ``wire.unknown_material``, ``wire.size``, ``wire.temperature``.
    """
    data = wire_material(material)
    issues = []
    kind: Literal["round", "strip"] = "round" if diameter_mm is not None else "strip"
    sizes = (diameter_mm, diameter_mm) if kind == "round" else (width_mm, thickness_mm)
    is_ambiguous = diameter_mm is not None and (width_mm is not None or thickness_mm is not None)
    width, thickness = (float(s) if s is not None else math.nan for s in sizes)
    is_valid = math.isfinite(width) and math.isfinite(thickness) and 0.0 < thickness <= width
    if is_ambiguous or not is_valid:
        text = (
            f"wire size: got diameter {diameter_mm}, width {width_mm}, thickness {thickness_mm} mm, "
            "allowed either a diameter, or a width and a thickness not above it, all above 0"
        )
        issues.append(Issue("wire.size", text, hint="give diameter_mm, or width_mm and thickness_mm"))
    if not (0.0 <= temperature_c <= data.limit_temperature):
        allowed = f"allowed 0 to {data.limit_temperature:.0f} C for {material}"
        text = f"wire temperature: got {temperature_c:.0f} C, {allowed}"
        issues.append(
            Issue(
                "wire.temperature",
                text,
                **measurement(temperature_c, data.limit_temperature, "C"),
                hint="cut cooler, or take another material",
            )
        )
    if issues:
        raise TandemError(issues)
    return HeatedWire(data, kind, width * MM, thickness * MM, float(temperature_c))
