"""Hot-wire cutting: bent wires between two arms, and straight wires in a bow."""
