"""The process ``straight_wire``: a bow with a straight hot wire."""
