"""The process ``elastic_wire``: a bent wire between two arms."""
