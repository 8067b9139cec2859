"""Planning of hot-wire cuts: bent and straight wires, the shapes of a wire, and the kerf."""
