"""The hot wire: bent and straight cuts, the wire's shapes, the kerf."""
